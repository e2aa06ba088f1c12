"""Scenes for `edge trajectory`: frames of a recorded street, or the built-in street."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from edge.config import Config, PipelinePlugin, WorldStreet
from edge.config.components import component_factory
from edge.errors import UserError
from edge.lab.eval import kitti
from edge.lab.sim.sensors import CameraRig, LidarRig
from edge.lab.sim.street import Street, street
from edge.lab.sim.worlds import load_world
from edge.perception.detection.sim import Segmentation, TruthAt
from edge.perception.masks.ground import make_ground_classifier
from edge.tasks.scene.on_demand import FrameDetector
from edge.tasks.scene.pipeline import PerceptionPipeline, boxes_as_masks, open_pipeline
from edge.tasks.scene.scene import Scene
from edge.tasks.scene.scene_builder import SceneBuilder
from edge.text import one_line
from edge.types import MASK_SIDE, Detections, Observation

MIN_PX = 60
"""An object of the built-in street with fewer pixels is not seen."""
MIN_SIDE_PX = 4
"""An object of the built-in street whose bounding box has a smaller side is not seen."""
ON_GROUND_M = 0.05
"""A return of the built-in street that is not higher is on the ground."""


class SceneCaptureError(UserError):
    """No objects in the scene, or no detector for them; a message of one line."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneCapture:
    """A scene and its sensor data.

    Attributes:
        by: source of the objects, such as "the labels".
        cloud_m: (n, 3) float32 in `map`, every return.
        base_z_m: height of the ground under the robot, in `map`.
        detect: looks for a new name in the newest frame; None: objects come from labels.
    """

    name: str
    by: str
    scene: Scene
    cloud_m: np.ndarray
    base_z_m: float
    detect: FrameDetector | None = None


def capture_kitti(
    folder: Path, numbers: Sequence[int], config: Config, words: Sequence[str] | None = None
) -> SceneCapture:
    """Build the scene of some frames of a SemanticKITTI sequence; without numbers, of the first.

    The detector looks for `words`, in addition to the configured ones; the regions are then flat,
    connected ground. Without words (None), objects and kinds of ground come from the labels.

    Raises:
        UserError: a frame cannot be read, or there is no detector.
    """
    labelled = words is None
    available = kitti.frames_in(folder, labelled)
    numbers = list(dict.fromkeys(numbers)) or available[:1]
    for number in numbers:
        if number not in available:
            listed = ", ".join(map(str, available))
            what = "image, scan and labels" if labelled else "image and scan"
            raise SceneCaptureError(
                f"--frames: {folder}: no frame {number} with {what} (choices: {listed})"
            )
    frames = [kitti.read_frame(folder, number, labelled) for number in numbers]
    clearance_m, detect = config.tasks.trajectory.clearance_m, None
    last = frames[-1].observation
    if words is None:
        scene, by = kitti.scene_of(frames, None, clearance_m), "the labels"
    else:
        with detector_pipeline(config, words) as (pipeline, by):
            scene = kitti.scene_of(frames, pipeline, clearance_m)
        detect = _frame_detector(last, config)
    cloud_m = np.concatenate([kitti.cloud_in_map(frame.observation) for frame in frames])
    frame_word = "frames" if len(numbers) > 1 else "frame"
    name = f"{folder.resolve().name}, {frame_word} {', '.join(map(str, numbers))}"
    return SceneCapture(
        name, by, scene, cloud_m.astype(np.float32), float(last.T_map_base[2, 3]), detect
    )


def capture_street(seed: int, config: Config, words: Sequence[str] | None = None) -> SceneCapture:
    """Build the scene of a built-in street, as the configured camera and LiDAR see it at its start.

    The kind of ground under each return is the street's own. `words` are as in `capture_kitti`;
    without them, the objects come from the simulator.

    Raises:
        UserError: there is no LiDAR, or no detector.
    """
    sim = config.sim.model_copy(update={"world": WorldStreet(seed=seed), "start": None})
    config = config.model_copy(update={"sim": sim})
    if config.sensors.lidar is None:
        raise SceneCaptureError(
            f"{config.locate('sensors.lidar')}: missing, but street:N needs a LiDAR; add this "
            "section"
        )
    world = load_world(config)
    camera, lidar = CameraRig(config, world), LidarRig(config, world)
    camera.look(world.start)
    lidar.look(world.start)
    seen = camera.observation(0, 0, world.start.matrix(), lidar)
    labels = tuple(obj.label for obj in world.objects)
    cloud_m, this_street = kitti.cloud_in_map(seen).astype(np.float32), street(seed)
    kinds = tuple(dict.fromkeys(ground.label for ground in this_street.grounds))
    truth = Segmentation(camera.ids, labels)

    def build_scene(pipeline: PerceptionPipeline) -> Scene:
        clearance_m = config.tasks.trajectory.clearance_m
        builder = SceneBuilder(pipeline, config.mapping, clearance_m, kinds)
        builder.add(seen, _ground_kind(this_street, kinds, cloud_m))
        return builder.scene()

    if words is None:
        scene, by = build_scene(_truth_pipeline(truth)), "the simulator"
    else:
        wanted = (*words, *dict.fromkeys(labels))
        with detector_pipeline(config, wanted, lambda _: truth) as (pipeline, by):
            scene = build_scene(pipeline)
    detect = None if words is None else _frame_detector(seen, config, lambda _: truth)
    return SceneCapture(this_street.name, by, scene, cloud_m, 0.0, detect)


def _frame_detector(
    observation: Observation, config: Config, truth: TruthAt | None = None
) -> FrameDetector:
    """Return what detects a new name in a frame, with the configured detector."""

    @contextmanager
    def open_for(name: str) -> Iterator[PerceptionPipeline]:
        with detector_pipeline(config, (name,), truth) as (pipeline, _):
            yield pipeline

    return FrameDetector(
        observation, open_for, config.tasks.trajectory.clearance_m, config.mapping.range_m
    )


@contextmanager
def detector_pipeline(
    config: Config, words: Sequence[str], truth: TruthAt | None = None
) -> Iterator[tuple[PerceptionPipeline, str]]:
    """Yield the detection pipeline of the configured detector, or a plugin, and its name.

    It looks for `words`, in addition to the detector's `background`. A simulated detector needs the
    ground truth.
    """
    ground = make_ground_classifier(config.tasks)
    if (plugin := config.tasks.pipeline) is not None:
        yield _plugin_pipeline(config, plugin, tuple(words))._replace(ground=ground), plugin.kind
        return
    detector = config.perception.detector
    if detector.kind == "sim" and truth is None:
        raise SceneCaptureError(
            f"{config.locate('perception.detector.kind')}: the simulated detector (sim) sees "
            "nothing in a real picture; choose a model (onnx), or give --objects labels"
        )
    # The detector always looks for its background, but it needs at least one word.
    words = tuple(words) or tuple(detector.background or ())[:1]
    if not words:
        raise SceneCaptureError(
            f"{config.locate('perception.detector.background')}: empty; give names of objects to "
            "detect"
        )
    with open_pipeline(config.perception, words, truth) as pipeline:
        by = detector.model if detector.kind == "onnx" else "the simulated detector"
        yield pipeline._replace(ground=ground), by


def _plugin_pipeline(
    config: Config, plugin: PipelinePlugin, words: tuple[str, ...]
) -> PerceptionPipeline:
    """Return the plugin pipeline of `tasks.pipeline`; its errors become `SceneCaptureError`."""
    where = config.locate("tasks.pipeline")
    arguments: dict[str, Any] = {"perception": config.perception, "words": words}
    part_names = ("tags", "boxes", "masks", "captions", "embeddings")  # fields, in order
    make = component_factory(
        "pipeline", plugin.kind, plugin.options, {}, where, part_names, tuple(arguments),
        functions=True,
    )  # fmt: skip
    pipeline = make(**arguments)

    def guarded(name: str) -> Callable[..., Any] | None:
        """Return a part of the pipeline that raises only `UserError`; None if it lacks the part."""
        part = getattr(pipeline, name)

        def called(*args: Any) -> Any:
            try:
                return part(*args)
            except UserError:
                raise
            except Exception as error:  # a plugin may raise anything
                reason = one_line(f"{type(error).__name__}: {error}")
                raise SceneCaptureError(
                    f"{where}: {plugin.kind}: {name}() raised {reason}"
                ) from None

        return None if part is None else called

    return PerceptionPipeline(*map(guarded, part_names))


def _truth_pipeline(truth: Segmentation) -> PerceptionPipeline:
    """Return a detection pipeline with boxes and masks from the picture of ids."""
    words = tuple(dict.fromkeys(truth.labels))

    def boxes(observation: Observation, tags: Sequence[str]) -> Detections:
        xyxy, class_id, masks = [], [], []
        for i, label in enumerate(truth.labels, start=1):
            shown = (truth.ids == i).astype(np.uint8)
            x, y, w, h = cv2.boundingRect(shown)
            if min(w, h) < MIN_SIDE_PX or np.count_nonzero(shown) < MIN_PX:
                continue
            part = cv2.resize(
                255 * shown[y : y + h, x : x + w], (MASK_SIDE, MASK_SIDE),
                interpolation=cv2.INTER_AREA if min(w, h) > MASK_SIDE else cv2.INTER_NEAREST,
            )  # fmt: skip
            xyxy.append((x, y, x + w, y + h))
            class_id.append(words.index(label))
            masks.append(part >= 128)  # at least half covered
        n = len(xyxy)
        return Detections(
            observation, np.array(xyxy, np.float32).reshape(n, 4), np.ones(n, np.float32),
            np.array(class_id, np.int32), words, model="the simulator",
            mask=np.array(masks, np.bool_).reshape(n, MASK_SIDE, MASK_SIDE),
        )  # fmt: skip

    return PerceptionPipeline(lambda observation: words, boxes, boxes_as_masks)


def _ground_kind(this_street: Street, kinds: Sequence[str], cloud_m: np.ndarray) -> np.ndarray:
    """Return (n,) uint8 by return: index of its ground in `kinds` plus 1; 0: no ground."""
    kind_of = np.zeros(1 + max(ground.id for ground in this_street.grounds), np.uint8)  # by id
    for ground in this_street.grounds:
        kind_of[ground.id] = 1 + kinds.index(ground.label)
    on_ground = np.abs(cloud_m[:, 2]) <= ON_GROUND_M
    return kind_of[this_street.ground_at(cloud_m[:, :2].astype(np.float64))] * on_ground
