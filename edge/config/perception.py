"""The section of perception: detectors, segmenters, scorers, and the tracking of objects."""

from __future__ import annotations

from typing import Annotated, Literal, Union

from pydantic import Field, field_validator, model_validator

from edge import names
from edge.config.section import (
    CardName,
    FilePath,
    Fraction,
    Name,
    NonNegative,
    OnnxModel,
    Positive,
    Section,
)
from edge.text import one_line

MAX_CONFIRM_HITS = 50
"""Largest `confirm_hits`: a track forgets old views, so it never has many more."""


class DetectorOnnx(Section):
    """An ONNX model as detector.

    Attributes:
        model: name of its card in `models/`.
        providers: execution providers of onnxruntime, best first; or `tensorrt` alone: TensorRT
            without onnxruntime.
        threads: CPU threads of the model.
        vocabulary: file of text embeddings (.npz). null: `$EDGE_VOCABULARY`, or the one of the
            model cache.
        background: names of other objects in the place. They compete with the targets for boxes, so
            that a bed is not taken for a sofa.
        tau_vl: boxes with a lower score are dropped.
        device_id: number of the GPU.
        engine_cache: folder of TensorRT engines; null: next to the models.
        fallback: card of a detector on this computer. It detects while the server of `model` gives
            no answer within 1.5 s (docs/remote.md); for a model on this computer it has no effect.
    """

    kind: Literal["onnx"] = "onnx"
    model: str = "yolo-world-s-256x320-int8-cpu"
    providers: tuple[str, ...] = ("CPUExecutionProvider",)
    threads: Annotated[int, Field(ge=1, le=64)] = 2
    vocabulary: FilePath | None = None
    background: tuple[Name, ...] = ()
    tau_vl: Fraction = 0.05
    device_id: Annotated[int, Field(ge=0)] = 0
    engine_cache: FilePath | None = None
    fallback: CardName | None = None


class DetectorSim(Section):
    """Objects of the simulator with noise, without a neural network. Finds nothing on a robot.

    Attributes:
        background: names of other objects to detect; null: all objects of the world.
        max_range_m: objects farther away are not detected.
        miss_rate: probability to miss a near object; three times that at `max_range_m`.
        false_positive_rate: probability to take another visible object for a target.
        score_noise: standard deviation of the score.
        tau_vl: boxes with a lower score are dropped.
    """

    kind: Literal["sim"] = "sim"
    background: tuple[Name, ...] | None = None
    max_range_m: Positive = 6.0
    miss_rate: Fraction = 0.1
    false_positive_rate: Fraction = 0.005
    score_noise: NonNegative = 0.08
    tau_vl: Fraction = 0.05
    seed: int = 0


class SegmenterNone(Section):
    """No masks: objects are located in 3-D from depth and boxes alone."""

    kind: Literal["none"] = "none"


class SegmenterGrabcut(Section):
    """Masks by colour: GrabCut of OpenCV, which needs no model.

    Attributes:
        max_boxes: only this many boxes, those with the highest scores, get a mask.
        time_limit_s: time for the masks of one image; boxes that are left then get none.
    """

    kind: Literal["grabcut"] = "grabcut"
    max_boxes: Annotated[int, Field(ge=1, le=64)] = 8
    time_limit_s: Positive = 0.05


class SegmenterOnnx(OnnxModel):
    """Masks by a model that takes boxes as prompts, such as SAM (a card of task `segment`).

    Attributes:
        max_boxes: only this many boxes, those with the highest scores, get a mask.
        time_limit_s: time for the masks of one image; boxes that are left then get none.
    """

    kind: Literal["onnx"] = "onnx"
    max_boxes: Annotated[int, Field(ge=1, le=64)] = 8
    time_limit_s: Positive = 1.0


class ModelProcessConfig(Section):
    """Supervision of a model in a separate process (`isolation: process`, and before a swap).

    A process that ended is started again, after a pause.

    Attributes:
        timeout_s: a frame that takes longer counts as a hang: the process is killed. Time in
            which the process waits for a CPU core does not count, up to `timeout_s` more.
        start_timeout_s: longest time without progress while the process starts and loads the
            model.
    """

    timeout_s: Positive = 0.8
    start_timeout_s: Positive = 60.0


class SwapConfig(Section):
    """Conditions for a model that replaces another one in the running service.

    The new model is tried on the last images. Its output must be valid, and its median time within
    the budget.
    If both are of one family, it must find half of the old model's boxes above `tau_det`. The old
    model stays loaded until the new one has passed the probation.

    Attributes:
        budget_ms: longest median time for an image.
        probation: number of images that the new model must process without a fault.
    """

    budget_ms: Positive = 33.0
    probation: Annotated[int, Field(ge=1)] = 60


class DegradationLevel(Section):
    """One degradation level: a cheaper detector, or a scorer that pauses.

    Attributes:
        model: card of a cheaper detector.
        pause: scorer that pauses: `similarity` or `choice`.
    """

    model: CardName | None = None
    pause: Literal["similarity", "choice"] | None = None

    @model_validator(mode="after")
    def _check_one_choice(self) -> DegradationLevel:
        if (self.model is None) == (self.pause is None):
            raise ValueError("set exactly one: model (a cheaper detector), or pause (a scorer)")
        return self


class LoadSheddingConfig(Section):
    """Load shedding: under load, expensive models are replaced or paused, in the given order.

    The next level is taken if the median time of the detector exceeds `perception.swap.budget_ms`,
    if the detector returns nothing, or if the board throttles or is about to. The level before is
    taken again when there is room (`edge.loop.load_shedder`).

    Attributes:
        levels: degradation levels, the first to be taken first; empty: no load shedding.
    """

    levels: tuple[DegradationLevel, ...] = ()


class ChoiceNone(Section):
    """No model chooses among the frontiers."""

    kind: Literal["none"] = "none"


class ChoiceServer(Section):
    """A model on an OpenAI-compatible server, which must return logprobs.

    Attributes:
        url: base URL of the server.
        model: name of the model on the server.
        api_key_env: environment variable that holds the API key.
        time_limit_s: time for one answer.
        pause_s: pause after an answer, to limit the cost of a paid server.
        fallback: card of a choice model on this computer, which answers while the server does not.
    """

    url: str
    model: str
    api_key_env: str = "OPENAI_API_KEY"
    time_limit_s: Positive = 5.0
    pause_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    fallback: CardName | None = None


class ChoiceOpenai(ChoiceServer):
    """A vision-language model scores the frontiers (ViTL eq. 4, 5).

    Attributes:
        max_image_px: longer side of the image that is sent.
    """

    kind: Literal["openai"] = "openai"
    max_image_px: Annotated[int, Field(ge=64, le=4096)] = 640


class ChoiceText(ChoiceServer):
    """A language model without images scores the frontiers, from a list of detected objects."""

    kind: Literal["text"] = "text"


class ChoiceOnnx(Section):
    """A model on this computer scores the frontiers.

    With `perception.isolation: process` it runs in a separate process at low priority, supervised
    by the rules of `perception.process`.

    Attributes:
        card: name of its card, of task `choice` (a language model) or `marks` (a small network).
        time_limit_s: time for one answer.
        pause_s: pause after an answer.
        max_image_px: longer side of the image. A model of task `marks` has a fixed image size; a
            smaller value is refused.
        providers: execution providers of onnxruntime, best first.
        threads: CPU threads of the model.
        device_id: number of the GPU.
    """

    kind: Literal["onnx"] = "onnx"
    card: str
    time_limit_s: Positive = 5.0
    pause_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    max_image_px: Annotated[int, Field(ge=64, le=4096)] = 640
    providers: tuple[str, ...] = ("CPUExecutionProvider",)
    threads: Annotated[int, Field(ge=1, le=64)] = 2
    device_id: Annotated[int, Field(ge=0)] = 0


class ChoiceCooccurrence(Section):
    """The prior (`perception.prior`) scores the frontiers by the objects near them."""

    kind: Literal["cooccurrence"] = "cooccurrence"


class PerceptionConfig(Section):
    """Detection and tracking of objects, and the models that score frontiers.

    Attributes:
        isolation: where ONNX models run. `thread`: in the service. `process`: in separate
            processes; a crash or hang of a model then costs detections, but no tick.
        process: supervision of these processes.
        swap: conditions for a change of the model at run time.
        load_shedding: work to drop when the computer is too slow.
        similarity: card of an image-text scorer (the score of VLFM); null: none runs.
        choice: model that scores the frontiers, to choose among them.
        segmenter: finds the pixels of a target in its box, so that its place is right although
            another object stands before it. It runs in the background, after the detector.
        prior: estimate of the likely places of a target that is not in view: by objects nearby
            (`cooccurrence`), by the kind of room (`rooms`), or both. Policies weigh it.
        tau_det: a box of at least this score starts a new object; weaker boxes count only for
            objects that are known.
        back_projection: source of the 3-D position of a box: `depth` image, or the LiDAR's `cloud`.
        back_projection_min_points: fewest points for a 3-D position.
        back_projection_max_range_m: boxes farther away get no 3-D position.
        merge_m: a detection within this distance of an object of its name belongs to that object.
        min_hits: an object counts as seen after detections in this many images.
        confirm_score: detections with a lower score do not count for `confirm_hits`.
        confirm_scores: lowest score by word, in place of `confirm_score`, for words that the
            detector takes other objects for; 1: practically no detection confirms one.
            `edge eval words` measures them.
        confirm_range_m: detections from farther away do not confirm an object, unless it hangs
            so high that the camera does not see it from there. A place that was closer than this
            in `confirm_hits` images was seen well. Before a target is declared not found, the
            robot looks again only at the other places.
        confirm_hits: number of images that confirm an object.
        confirm_mean: lowest mean score over all views from nearby for a confirmed object.
        confirm_lead: the summed score must be this many times that of any other name.
    """

    isolation: Literal["thread", "process"] = "thread"
    process: ModelProcessConfig = ModelProcessConfig()
    swap: SwapConfig = SwapConfig()
    load_shedding: LoadSheddingConfig = LoadSheddingConfig()
    similarity: CardName | None = None
    choice: Annotated[
        Union[ChoiceNone, ChoiceOpenai, ChoiceText, ChoiceOnnx, ChoiceCooccurrence],
        Field(discriminator="kind"),
    ] = ChoiceNone()
    detector: Annotated[
        Union[DetectorOnnx, DetectorSim],
        Field(
            discriminator="kind",
            description="set onnx for a robot's camera; sim finds only objects of the simulator",
        ),
    ]
    segmenter: Annotated[
        Union[SegmenterNone, SegmenterGrabcut, SegmenterOnnx], Field(discriminator="kind")
    ] = SegmenterNone()
    prior: Literal["none", "cooccurrence", "rooms", "both"] = "both"
    tau_det: Fraction = 0.3
    back_projection: Literal["depth", "cloud"] = "depth"
    back_projection_min_points: Annotated[int, Field(ge=1)] = 8
    back_projection_max_range_m: Positive = 8.0
    merge_m: Positive = 0.6
    min_hits: Annotated[int, Field(ge=1)] = 2
    confirm_score: Fraction = 0.35
    confirm_scores: dict[Name, Fraction] = Field(default_factory=dict)
    confirm_range_m: Positive = 3.0
    confirm_hits: Annotated[int, Field(ge=1, le=MAX_CONFIRM_HITS)] = 3
    confirm_mean: Fraction = 0.12
    confirm_lead: Annotated[float, Field(ge=1)] = 1.5

    @field_validator("confirm_scores")
    @classmethod
    def _with_canonical_names(cls, scores: dict[str, float]) -> dict[str, float]:
        words: dict[str, str] = {}  # canonical name → word as given
        for word in scores:
            other = words.setdefault(names.canonical(word), word)
            if other != word:
                raise ValueError(f"{one_line(other)} and {one_line(word)} are one name: keep one")
        return {name: scores[word] for name, word in words.items()}

    def confirm_score_of(self, name: str) -> float:
        """Return the lowest score that confirms an object of a canonical name."""
        return self.confirm_scores.get(name, self.confirm_score)

    @model_validator(mode="after")
    def _check_isolation(self) -> PerceptionConfig:
        if self.isolation == "process" and self.detector.kind != "onnx":
            raise ValueError(
                f"isolation: process needs perception.detector.kind: onnx; the detector "
                f"{self.detector.kind} runs in the service"
            )
        return self

    @model_validator(mode="after")
    def _check_load_shedding(self) -> PerceptionConfig:
        for i, level in enumerate(self.load_shedding.levels):
            key = f"load_shedding: levels: {i}"
            if level.model is not None and self.detector.kind != "onnx":
                raise ValueError(
                    f"{key}: model: needs perception.detector.kind: onnx; the detector "
                    f"{self.detector.kind} has no model to replace"
                )
            runs = {
                "similarity": self.similarity is not None,
                "choice": self.choice.kind not in ("none", "cooccurrence"),
            }
            if level.pause is not None and not runs[level.pause]:
                raise ValueError(
                    f"{key}: pause: {level.pause}: this scorer is not configured: set "
                    f"perception.{level.pause}, or remove this level"
                )
        return self
