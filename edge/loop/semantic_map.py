"""The semantic map: all that is known of the surroundings, in the frame `map`.

What is free and what is not, what was seen where, and which places the robot may be sent to. It has
one owner, since it begins with the frame and ends with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from edge.config import Config
from edge.geometry import Grid
from edge.host.checkpoint import Arrays
from edge.loop.candidates import CandidatePool
from edge.loop.prior import make_prior
from edge.loop.result import VALUE_LAYER
from edge.mapping.grid import MAX_FRONTIERS, RollingMap
from edge.mapping.results import MapUpdate
from edge.mapping.view import MapView
from edge.memory import Site
from edge.perception.tracking.instances import MAX_INSTANCES, InstanceTracker
from edge.perception.tracking.lift import Lifter
from edge.perception.tracking.sightings import SightingTracker
from edge.types import Detections, Instance, Observation


class SemanticMap:
    """Stages 3 to 5 of the tick write it, in this order: `update`, `look`, `infer`, `gather`.

    Args:
        targets: of the mission to begin with.

    Attributes:
        config: that it goes by; set by `reconfigure`.
        grid: occupancy, frontiers, distances and value maps; another object in another frame.
        view: what a policy sees of the grid.
        sightings: where anything was seen; `tracker`: the instances of targets.
        pool: the candidates.
        prior: what all that was seen says about places; None where it is not gone by.
        epoch: counts the frames.
    """

    def __init__(self, config: Config, targets: Sequence[str]) -> None:
        perception = config.perception
        self.config, self._targets = config, targets
        self.sightings = SightingTracker(perception)
        self.tracker = InstanceTracker(perception, self.sightings)
        self.pool = CandidatePool(MAX_FRONTIERS + MAX_INSTANCES, config.policy.r_assoc_m)
        self.prior = make_prior(config)
        self.epoch = 0
        self._lifter = Lifter(perception)
        self._zones_m: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
        self._lay(RollingMap(config.mapping, config.robot))

    def _lay(self, grid: RollingMap) -> None:
        """Put a grid in the place of the one that there was."""
        self.grid, self.view = grid, MapView(grid)
        grid.set_zones(*self._zones_m)
        self._feed_values()

    def _feed_values(self) -> None:
        """A value map for each target, where a scorer is to write them."""
        if self.config.value_source is not None:
            self.grid.values.begin(self._targets)

    # -- in each tick -----------------------------------------------------------------------

    def update(self, observation: Observation, now_ns: int) -> MapUpdate | None:
        """Fold the depth image or cloud in; None where the observation has none."""
        grid, seen, update = self.grid, observation, None
        grid.bumps.expire(now_ns)
        if self.config.mapping.input == "cloud":
            if seen.cloud_m is not None:
                update = grid.update_cloud(seen.cloud_m, seen.T_map_base, seen.T_base_lidar)
        elif seen.depth_m is not None and seen.camera is not None:
            update = grid.update_depth(
                seen.depth_m, seen.camera, seen.T_map_base, seen.T_base_camera
            )
        grid.reach.step(seen.pose)
        return update

    def look(self, detections: Detections) -> None:
        """Boxes become sightings and instances, by the depth and pose that they were seen with."""
        perception, seen = self.config.perception, detections.observation
        lifted, around = self._lifter.lift(detections, self.grid.floor_over_base_m)
        self.sightings.look(lifted, around)
        self.tracker.update(lifted, seen.stamp_ns)
        self.tracker.expire(seen, detections.prompts)
        self.grid.coverage.look(seen, perception.confirm_range_m, perception.confirm_hits)

    def infer(self, now_ns: int) -> None:
        """What was seen says something about what was not."""
        if self.prior is not None:
            self.prior.step(self.view, self.sightings.shown, now_ns)

    def gather(self, instances: Sequence[Instance], observation: Observation, now_ns: int) -> None:
        """The candidates: frontiers, these instances, and the turn that shows most."""
        pool, policy, camera = self.pool, self.config.policy, observation.camera
        pool.update(self.grid.frontiers, instances, observation.stamp_ns, now_ns)
        pool.measure(self.grid)
        if policy.look_round and camera is not None:
            pool.add_look(self.grid, observation.pose, camera.hfov_rad, now_ns)

    # -- from one mission, configuration or frame to another --------------------------------

    def begin(self, targets: Sequence[str]) -> None:
        """Another mission: its targets were not looked at before, nor refuted."""
        self._targets = targets
        self._feed_values()
        self.tracker.forget_verdicts()
        self.tracker.recall(targets)
        self.grid.coverage.forget()

    def set_site(self, site: Site) -> None:
        """Close the cells that the site's zones close."""
        self._zones_m = site.polygons_m("keep_out"), site.polygons_m("stay_inside")
        self.grid.set_zones(*self._zones_m)

    def reconfigure(self, config: Config) -> None:
        """Go by another configuration; see `edge.loop.reload.LIVE` for what may differ."""
        if config.value_source != self.config.value_source:
            self.grid.values.begin(())  # what another scorer said means something else
        self.config = config
        self.tracker.config = self.sightings.config = self._lifter.config = config.perception
        self.pool.r_assoc_m = config.policy.r_assoc_m
        self._feed_values()

    def forget(self) -> None:
        """The frame is another: nothing that was known means anything there."""
        self.epoch += 1
        self._lay(RollingMap(self.config.mapping, self.config.robot))
        self.tracker.clear()
        self.sightings.clear()
        self.pool.clear()
        if self.prior is not None:
            self.prior.forget()

    def state_dict(self) -> dict[str, Arrays]:
        """Return all that lasts but the tiles, by part."""
        grid = self.grid
        return {
            "map": grid.state_dict(), "gain": grid.gain.state_dict(),
            "bumps": grid.bumps.state_dict(), "sightings": self.sightings.state_dict(),
            "instances": self.tracker.state_dict(), "candidates": self.pool.state_dict(),
        }  # fmt: skip

    def load_state_dict(
        self,
        grid: RollingMap,
        part: Callable[[str], Arrays],
        later_ns: int,
        later_stamp_ns: int,
    ) -> None:
        """Go on with a `state_dict`, in the same frame.

        Args:
            grid: the new one of that frame; see `edge.loop.map_checkpoint.make_map`.
            part: returns the arrays of a part.
            later_ns, later_stamp_ns: how much later it all happened on the loop's clock, and on the
                sensors'.
        """
        self._lay(grid)
        grid.bumps.load_state_dict(part("bumps"), later_ns)
        self.sightings.load_state_dict(part("sightings"), later_stamp_ns)
        self.tracker.load_state_dict(part("instances"), later_stamp_ns)
        self.pool.load_state_dict(part("candidates"), later_ns, later_stamp_ns)

    def close(self) -> None:
        """Nothing is asked any more."""
        if self.prior is not None:
            self.prior.close()

    # -- for people -------------------------------------------------------------------------

    def layers(self, likely: bool) -> dict[str, Callable[[], Grid]]:
        """See `edge.loop.result.TickResult.layers`.

        Args:
            likely: the prior's as well, where it is gone by.
        """
        valued = self._targets if self.config.value_source is not None else ()
        values, found = self.grid.values, {"looked at": self.grid.coverage.snapshot}
        found |= {VALUE_LAYER + target: partial(values.snapshot, target) for target in valued}
        if self.prior is not None and likely:
            found |= {f"likely place of {x}": self.prior.layer(x) for x in self._targets}
        return found
