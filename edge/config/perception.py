"""Detectors, scorers, and what is made of their answers."""

from __future__ import annotations

from typing import Annotated, Literal, Union

from pydantic import Field, model_validator

from edge.config.section import Fraction, NonNegative, Positive, Section


class DetectorOnnx(Section):
    """An ONNX detector; `model` names a card in `models/`.

    `providers` are onnxruntime's, in the order of preference, or `tensorrt` alone: TensorRT itself,
    without onnxruntime. `device_id` is the GPU. Engines of TensorRT are kept in `engine_cache`, by
    default beside the models.
    """

    kind: Literal["onnx"] = "onnx"
    model: str = "yolo-world-s-256x320-int8-cpu"
    providers: tuple[str, ...] = ("CPUExecutionProvider",)
    threads: Annotated[int, Field(ge=1, le=64)] = 2
    vocabulary: str | None = None
    background: tuple[str, ...] = ()
    tau_vl: Fraction = 0.05
    device_id: Annotated[int, Field(ge=0)] = 0
    engine_cache: str | None = None


class DetectorSim(Section):
    """Object ids from the simulator's ray caster with a noise model: no neural network.

    `background` names what is seen besides the targets; null: everything that the world has.
    """

    kind: Literal["sim"] = "sim"
    background: tuple[str, ...] | None = None
    max_range_m: Positive = 6.0
    miss_rate: Fraction = 0.1
    false_positive_rate: Fraction = 0.005
    score_noise: NonNegative = 0.08
    tau_vl: Fraction = 0.05
    seed: int = 0


class SegmenterNone(Section):
    """No masks: lifting goes by depth and by the boxes alone."""

    kind: Literal["none"] = "none"


class SegmenterGrabcut(Section):
    """Masks by colour: GrabCut in OpenCV, which needs no model.

    The `max_boxes` boxes of the highest scores have masks, as many of them as are made in
    `time_limit_s`.
    """

    kind: Literal["grabcut"] = "grabcut"
    max_boxes: Annotated[int, Field(ge=1, le=64)] = 8
    time_limit_s: Positive = 0.05


class SegmenterOnnx(Section):
    """Masks by a model that takes boxes as prompts, as SAM does; `model` names a card of task
    `segment`.

    `providers` are onnxruntime's, `device_id` is the GPU. An image that takes longer than
    `time_limit_s` is given up: its boxes go on with the masks made until then.
    """

    kind: Literal["onnx"] = "onnx"
    model: str
    providers: tuple[str, ...] = ("CPUExecutionProvider",)
    threads: Annotated[int, Field(ge=1, le=64)] = 2
    device_id: Annotated[int, Field(ge=0)] = 0
    max_boxes: Annotated[int, Field(ge=1, le=64)] = 8
    time_limit_s: Positive = 1.0


class ModelProcess(Section):
    """How a model in a process of its own is looked after (`isolation: process`; before a swap).

    A frame that takes longer than `timeout_s` counts as a hang; what its process waited for a core
    is added to that, at most as much again. A process that ended is started again
    (`edge.perception.process.kept`).
    """

    timeout_s: Positive = 0.8
    start_timeout_s: Positive = 60.0


class Swap(Section):
    """What a model must do to take another's place in the running service.

    It is tried on the last images: sound, at most `budget_ms` at the median, and, if both are of
    one family, half of the boxes above `tau_det` that the old one finds. The old one is kept until
    the new one has run clean on `probation` images.
    """

    budget_ms: Positive = 33.0
    probation: Annotated[int, Field(ge=1)] = 60


class Rung(Section):
    """One thing to give up: the model, for that of a cheaper card, or a scorer, which rests."""

    model: str | None = None
    rest: Literal["similarity", "choice"] | None = None

    @model_validator(mode="after")
    def _one_thing(self) -> Rung:
        if (self.model is None) == (self.rest is None):
            raise ValueError("name a model, or a scorer to rest")
        return self


class Governor(Section):
    """What is given up, rung by rung, when the computer cannot keep up; no ladder, no governor.

    A rung is stepped down when the detector takes longer at the median than
    `perception.swap.budget_ms`, detects nothing, or the board throttles or soon would. It is
    stepped up again when there is room (`edge.loop.ladder`).
    """

    ladder: tuple[Rung, ...] = ()


class ChoiceNone(Section):
    """No model is asked which way to go."""

    kind: Literal["none"] = "none"


class ChoiceOpenai(Section):
    """ViTL eq. 4 and 5 by a server that speaks OpenAI's protocol, with images and logprobs.

    `rest_s` is how long after an answer the next question is asked; a paid server's price.
    """

    kind: Literal["openai"] = "openai"
    url: str
    model: str
    api_key_env: str = "OPENAI_API_KEY"
    time_limit_s: Positive = 5.0
    rest_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    max_image_px: Annotated[int, Field(ge=64, le=4096)] = 640


class ChoiceText(Section):
    """The same by a language model without eyes, told what was detected and where."""

    kind: Literal["text"] = "text"
    url: str
    model: str
    api_key_env: str = "OPENAI_API_KEY"
    time_limit_s: Positive = 5.0
    rest_s: Annotated[float, Field(ge=0, le=3600)] = 0.0


class ChoiceOnnx(Section):
    """The same by a model that runs here; `card` names one in `models/`.

    One of task `choice` is a language model, one of task `marks` a small network, whose images are
    of its own size: a smaller `max_image_px` is refused. With `perception.isolation: process` it
    has a process of its own, started again by the rules of `perception.process`, which gets what
    the loop and the detector leave of the cores.
    """

    kind: Literal["onnx"] = "onnx"
    card: str
    time_limit_s: Positive = 5.0
    rest_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    max_image_px: Annotated[int, Field(ge=64, le=4096)] = 640
    providers: tuple[str, ...] = ("CPUExecutionProvider",)
    threads: Annotated[int, Field(ge=1, le=64)] = 2
    device_id: Annotated[int, Field(ge=0)] = 0


class ChoiceCooccurrence(Section):
    """The same by the prior (`perception.prior`): what stands near a frontier makes it likely."""

    kind: Literal["cooccurrence"] = "cooccurrence"


class Perception(Section):
    """`similarity` names the card of an image-text scorer (VLFM's score), if one is to run.

    What the detector says counts within `confirm_range_m`: a thing found there in `confirm_hits`
    images can be confirmed, and a place that was there in so many was seen well, so that it need
    not be looked at again before a target is given up.

    `prior` says by what that was seen places are judged where no target is in view: what stands
    near (`cooccurrence`), which kind of room it is (`rooms`), or both. Policies weigh it.

    `segmenter` says which pixels of a target's box are the target's, so that a thing behind another
    in one box is lifted right; it works beside the loop, after the detector.
    """

    isolation: Literal["thread", "process"] = "thread"
    process: ModelProcess = ModelProcess()
    swap: Swap = Swap()
    governor: Governor = Governor()
    similarity: str | None = None
    choice: Annotated[
        Union[ChoiceNone, ChoiceOpenai, ChoiceText, ChoiceOnnx, ChoiceCooccurrence],
        Field(discriminator="kind"),
    ] = ChoiceNone()
    detector: Annotated[
        Union[DetectorOnnx, DetectorSim],
        Field(
            discriminator="kind",
            description="a robot's camera wants onnx, sim sees nothing but the simulator's objects",
        ),
    ]
    segmenter: Annotated[
        Union[SegmenterNone, SegmenterGrabcut, SegmenterOnnx], Field(discriminator="kind")
    ] = SegmenterNone()
    prior: Literal["none", "cooccurrence", "rooms", "both"] = "both"
    tau_det: Fraction = 0.3
    lift: Literal["depth", "cloud"] = "depth"
    lift_min_points: Annotated[int, Field(ge=1)] = 8
    lift_max_range_m: Positive = 8.0
    voxel_m: Positive = 0.1
    merge_m: Positive = 0.6
    min_hits: Annotated[int, Field(ge=1)] = 2
    confirm_score: Fraction = 0.35
    confirm_range_m: Positive = 3.0
    confirm_hits: Annotated[int, Field(ge=1)] = 3
    confirm_mean: Fraction = 0.12
    confirm_lead: Annotated[float, Field(ge=1)] = 1.5
    refute_radius_m: NonNegative = 0.6

    @model_validator(mode="after")
    def _isolable(self) -> Perception:
        if self.isolation == "process" and self.detector.kind != "onnx":
            raise ValueError(
                f"isolation: process: only for perception.detector.kind: onnx, "
                f"{self.detector.kind} runs in the service"
            )
        return self

    @model_validator(mode="after")
    def _has_what_the_ladder_gives_up(self) -> Perception:
        for i, rung in enumerate(self.governor.ladder):
            key = f"governor: ladder: {i}"
            if rung.model is not None and self.detector.kind != "onnx":
                raise ValueError(
                    f"{key}: model: only for perception.detector.kind: onnx, "
                    f"{self.detector.kind} has none to step down from"
                )
            runs = {
                "similarity": self.similarity is not None,
                "choice": self.choice.kind not in ("none", "cooccurrence"),
            }
            if rung.rest is not None and not runs[rung.rest]:
                raise ValueError(f"{key}: rest: {rung.rest}: no such model is asked")
        return self
