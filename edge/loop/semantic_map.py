"""The semantic map: all knowledge of the surroundings, in the frame `map`.

One class owns the occupancy grid, the objects and the candidates, because all of them are valid
only in the current frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from edge.config import Config
from edge.geometry import SE2, Grid, optical_yaw_rad
from edge.host.checkpoint import Arrays
from edge.loop.goals.candidates import CandidatePool
from edge.loop.result import VALUE_LAYER
from edge.loop.scoring.prior import make_prior
from edge.loop.scoring.room_surveyor import RoomSurveyor
from edge.mapping.clusters import MAX_FRONTIERS
from edge.mapping.grid import RollingMap
from edge.mapping.results import MapUpdate
from edge.mapping.view import MapView
from edge.memory import CropStore, DescribedTargets, MappedRoom, RoomMemory, Site
from edge.perception.prior.table import load
from edge.perception.prior.words import make_words
from edge.perception.tracking.back_projection import BackProjector
from edge.perception.tracking.fusion import InstanceFusion
from edge.perception.tracking.instances import MAX_INSTANCES, InstanceTracker
from edge.perception.tracking.object_tracker import ObjectTracker
from edge.types import Detections, Instance, Observation

_SAME_AREA_M2 = 0.5  # smallest change of a closed room's area for which it is painted again


class SemanticMap:
    """The semantic map. The stages `map`, `lift` and `candidates` of the tick write it.

    They call `update`, `on_detections`, `infer` and `update_candidates`, in this order.

    Attributes:
        config: Current configuration; set by `reconfigure`.
        grid: Occupancy, frontiers, distances and value maps. Another frame has another grid.
        view: The part of the grid that policies see.
        objects: All objects that were seen.
        tracker: Instances: the objects that were detected as a target.
        described: Finds the instances of targets that a relation describes.
        crops: Pictures of the objects in `objects`.
        pool: Candidates for goals.
        rooms: Rooms of the map, with names and objects.
        room_surveyor: Finds the rooms in the background.
        prior: Likelihood of targets near places; None if no prior is configured.
        epoch: Number of pose jumps (changes of the frame).
    """

    def __init__(self, config: Config, targets: Sequence[str]) -> None:
        perception = config.perception
        self.config, self._targets = config, targets
        self.objects = ObjectTracker(perception)
        self.tracker = InstanceTracker(perception)
        self._fusion = InstanceFusion(self.tracker, self.objects)
        self.crops = CropStore()
        self.pool = CandidatePool(MAX_FRONTIERS + MAX_INSTANCES, config.policy.r_assoc_m)
        words = make_words(load(), perception.detector)
        self.room_surveyor = RoomSurveyor(config.loop.lockstep)
        self.rooms = RoomMemory(load(), words)
        self.tracker.resolver = DescribedTargets(self.rooms.is_in, self._is_floor_between)
        self.prior = make_prior(config, words)
        self.epoch = 0
        self._fov_rad: float | None = None  # of the first camera
        self._back_projector = BackProjector(perception)
        self._closed_rooms: dict[int, MappedRoom] = {}
        self._set_grid(RollingMap(config.mapping, config.robot))

    def _set_grid(self, grid: RollingMap) -> None:
        self.grid, self.view = grid, MapView(grid)
        self._set_zones()
        self._reset_values()

    def _reset_values(self) -> None:
        """Make a value map for each target, if a scorer writes them."""
        if self.config.value_source is not None:
            self.grid.values.set_targets(self._targets)

    # -- in each tick -----------------------------------------------------------------------

    def update(self, observation: Observation, now_ns: int) -> MapUpdate | None:
        """Integrate the depth image or cloud; return None if the observation has none."""
        grid, update, T = self.grid, None, observation.T_map_base
        grid.bumps.expire(now_ns)
        if self.config.mapping.input == "cloud":
            if observation.cloud_m is not None:
                update = grid.update_cloud(observation.cloud_m, T, observation.T_base_lidar)
        elif observation.depth_m is not None and observation.camera is not None:
            update = grid.update_depth(
                observation.depth_m, observation.camera, T, observation.T_base_camera
            )
        grid.travel_cost.step(observation.pose)
        return update

    def on_detections(self, detections: Detections) -> None:
        """Turn boxes into objects and instances, with the depth and pose of their image."""
        c, observation = self.config.perception, detections.observation
        targets, others = self._back_projector.back_project(detections, self.grid.floor_over_base_m)
        self.objects.update(targets, others)
        self.crops.rename(self.objects.moved.renamed)
        if observation.rgb is not None:
            self.crops.observe(self.objects.observed, observation.rgb)
        self._fusion.update(targets, observation.stamp_ns)
        self._fusion.expire(observation, detections.prompts)
        self.grid.coverage.on_image(observation, c.confirm_range_m, c.confirm_hits)

    def infer(self, pose: SE2, now_ns: int) -> None:
        """Update rooms and prior with the objects seen."""
        self.room_surveyor.step(self.rooms, self.view, now_ns)
        self.rooms.on_pose(pose.x_m, pose.y_m)
        self.rooms.update(self.objects.read_only, now_ns)
        if self.prior is not None:
            self.prior.step(self.rooms.survey.regions, self.objects.read_only)

    def update_candidates(
        self, instances: Sequence[Instance], observation: Observation, now_ns: int
    ) -> None:
        """Update the candidates: frontiers, these instances, and the best spin."""
        pool, camera = self.pool, observation.camera
        pool.update(self.grid.frontiers, instances, observation.stamp_ns, now_ns)
        pool.measure(self.grid)
        if not self.config.policy.spin or camera is None:
            return
        if observation.camera_index == 0:
            self._fov_rad = camera.hfov_rad
        else:  # spins are planned for the first camera, and this one looks elsewhere
            yaw_rad = optical_yaw_rad(observation.T_base_camera)
            self.grid.gain.on_view(observation.pose, yaw_rad, camera.hfov_rad)
        if self._fov_rad is not None:
            pool.add_spin(self.grid, observation.pose, self._fov_rad, now_ns)

    # -- from one mission, configuration or frame to another --------------------------------

    def begin(self, targets: Sequence[str]) -> None:
        """Prepare for another mission: forget verdicts and viewpoints of the last one."""
        self._targets = targets
        self._reset_values()
        self.close_rooms(())
        self.tracker.forget_verdicts()
        self._fusion.promote_context(targets)
        self.grid.coverage.reset()

    def set_site(self, site: Site) -> None:
        """Close the cells that the site's zones close, and name the rooms that it names."""
        self.rooms.set_site(site)
        self._set_zones()

    def close_rooms(self, rooms: Sequence[MappedRoom]) -> None:
        """Close these rooms like zones, and open those that were closed before.

        A closed room keeps its outline until its area has changed, because painting costs time.
        """
        before = self._closed_rooms
        self._closed_rooms = {
            room.id: before[room.id]
            if room.id in before and abs(before[room.id].area_m2 - room.area_m2) < _SAME_AREA_M2
            else room
            for room in rooms
        }
        if [*self._closed_rooms.values()] != [*before.values()]:
            self._set_zones()

    def _set_zones(self) -> None:
        site = self.rooms.site
        closed_m = [room.polygon_m for room in self._closed_rooms.values()]
        self.grid.set_zones(
            [*site.polygons_m("keep_out"), *closed_m], site.polygons_m("stay_inside")
        )

    def reconfigure(self, config: Config) -> None:
        """Use another configuration; see `edge.loop.reload.LIVE` for the keys that may differ."""
        if config.value_source != self.config.value_source:
            self.grid.values.set_targets(())  # values of another scorer are not comparable
        self.config = config
        self.tracker.config = self.objects.config = self._back_projector.config = config.perception
        self.pool.r_assoc_m = config.policy.r_assoc_m
        self._reset_values()

    def on_pose_jump(self) -> None:
        """Forget everything, since the frame has changed."""
        self.epoch += 1
        self._closed_rooms = {}
        self._set_grid(RollingMap(self.config.mapping, self.config.robot))
        self.tracker.clear()
        self.objects.clear()
        self.crops.clear()
        self.pool.clear()
        self.room_surveyor.discard_pending()
        self.rooms.on_pose_jump()

    def _is_floor_between(self, point_m: np.ndarray, other_m: np.ndarray) -> bool:
        return self.grid.is_floor_between(point_m, other_m)  # another frame has another grid

    def state_dict(self) -> dict[str, Arrays]:
        """Return the arrays to save by part, without the tiles of the grid."""
        grid = self.grid
        return {
            "map": grid.state_dict(), "gain": grid.gain.state_dict(),
            "bumps": grid.bumps.state_dict(), "sightings": self.objects.state_dict(),
            "instances": self.tracker.state_dict(), "candidates": self.pool.state_dict(),
            "rooms": self.rooms.state_dict(),
        }  # fmt: skip

    def load_state_dict(
        self,
        grid: RollingMap,
        part: Callable[[str], Arrays],
        clock_shift_ns: int,
        stamp_shift_ns: int,
    ) -> None:
        """Restore a `state_dict` in the same frame.

        Args:
            grid: The restored grid; see `edge.loop.checkpoints.map_checkpoint.make_map`.
            part: Returns the arrays of a part, by its name in `state_dict`.
            clock_shift_ns: Added to saved times of the loop's clock.
            stamp_shift_ns: Added to saved stamps of the sensors' clock.
        """
        self._set_grid(grid)
        grid.bumps.load_state_dict(part("bumps"), clock_shift_ns)
        self.objects.load_state_dict(part("sightings"), stamp_shift_ns)
        self.tracker.load_state_dict(part("instances"), stamp_shift_ns)
        self.pool.load_state_dict(part("candidates"), clock_shift_ns, stamp_shift_ns)
        self.room_surveyor.discard_pending()
        self.rooms.load_state_dict(part("rooms"))

    def close(self) -> None:
        """Stop the background work."""
        self.crops.close()
        self.room_surveyor.close()

    # -- layers for displays ------------------------------------------------------------------

    def layers(self, likely: bool) -> dict[str, Callable[[], Grid]]:
        """Return the layers of the map; see `edge.loop.result.TickResult.layers`."""
        targets = self._targets if self.config.value_source is not None else ()
        values, layers = self.grid.values, {"looked at": self.grid.coverage.snapshot}
        layers |= {VALUE_LAYER + target: partial(values.snapshot, target) for target in targets}
        if self.prior is not None and likely:
            layers |= {f"likely place of {x}": self.prior.layer(x) for x in self._targets}
        return layers
