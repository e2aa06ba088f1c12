"""Detection of a new name on the frame at hand, for `det_object` (OpenNav algorithm 1, line 12)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np

from edge import names
from edge.tasks.scene.pipeline import PerceptionPipeline, run_pipeline
from edge.tasks.scene.scene import Scene
from edge.tasks.scene.scene_builder import with_detected
from edge.types import Detections, Observation


@dataclass(frozen=True, slots=True, eq=False)
class FrameDetector:
    """A detector that looks for one more name in a frame; call it as `detector(name, scene)`.

    Attributes:
        observation: the frame, with a picture and a cloud or depth.
        open_pipeline: opens a pipeline that looks for a name, and closes it.
        radius_m: clearance of the trajectories; at least the robot's radius.
    """

    observation: Observation
    open_pipeline: Callable[[str], AbstractContextManager[PerceptionPipeline]]
    radius_m: float
    range_m: float

    def __call__(self, name: str, scene: Scene) -> Scene:
        """Return the scene with the objects of this name that the frame shows, under new ids.

        Raises:
            UserError: the detector does not know the name, or cannot be loaded.
        """
        with self.open_pipeline(name) as pipeline:

            def boxes(observation: Observation, tags: Sequence[str]) -> Detections:
                found = pipeline.boxes(observation, tags)
                is_wanted = [names.is_kind_of(found.prompts[k], name) for k in found.class_id]
                return found.only(np.array(is_wanted, np.bool_))

            wanted = pipeline._replace(tags=lambda observation: (name,), boxes=boxes)
            result = run_pipeline(wanted, self.observation)
        return with_detected(scene, result, self.radius_m, self.range_m)
