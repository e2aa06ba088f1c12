"""Verification of the objects at which a task stops, like targets of a mission."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Literal

from edge.config import Config
from edge.geometry import SE2
from edge.loop.behaviours.plan_worker import SAME_OBJECT_M
from edge.loop.goals.goal import MIN_IMAGES
from edge.perception.tracking.instances import InstanceTracker
from edge.types import Instance

FACING_RAD = math.radians(25.0)
"""The robot faces an object if the angle to it is not larger than this."""


class StopVerification:
    """Verifies the objects of one stop, one after the other; for the loop's thread.

    Attributes:
        turn: Goal of the turn towards the object; None for none.
    """

    def __init__(
        self,
        objects: Iterable[tuple[int, str]],
        tracker: InstanceTracker,
        log: Callable[[str, int], None],
    ) -> None:
        self._objects, self._tracker, self._log = list(objects), tracker, log
        self._verified: set[int] = set()
        self.turn: SE2 | None = None
        # Images and loop time when the robot began to look at the first object; None: not yet.
        self._since: tuple[int, int] | None = None

    def step(
        self, pose: SE2, turn_ended: bool, images: int, config: Config, now_ns: int
    ) -> Literal["", "verified", "rejected"]:
        """Verify the next object; return the result of the stop, "" while it lasts.

        An object that is too far away to verify is accepted. `images` is the number of images that
        the detector has processed so far.
        """
        images_before, since_ns = self._since = self._since or (images, now_ns)
        (number, label), perception = self._objects[0], config.perception
        near = [
            one
            for one in self._tracker.of(label)
            if one.distance_m(pose.x_m, pose.y_m) <= min(SAME_OBJECT_M, perception.confirm_range_m)
            and one.id not in self._verified
        ]
        near.sort(key=lambda one: (one.id != number, one.distance_m(pose.x_m, pose.y_m)))
        obj = self._tracker.get(number)
        found = next((one for one in near if one.is_confirmed), None)
        is_away = obj is not None and obj.state != "rejected" and not near
        if obj is not None and is_away and not obj.is_confirmed:
            away_m = obj.distance_m(pose.x_m, pose.y_m)
            text = f"{label} {number} is {away_m:.1f} m away: too far to verify, accepted"
            self._log(text, now_ns)
        if is_away or found is not None:
            self._verified.add(number if found is None else found.id)
            self.turn, self._since = None, None
            self._objects.pop(0)
            return "" if self._objects else "verified"
        looked_s = (now_ns - since_ns) * 1e-9
        if near and not self._faces(near[0], pose, turn_ended):
            self._since = None
        elif images - images_before >= MIN_IMAGES and looked_s > config.mission.verify_s:
            if near:  # the object may have got another id
                number = near[0].id
            self._tracker.reject(number)
            text = f"{label} {number} was not confirmed from near by, rejected: exploring further"
            self._log(text, now_ns)
            return "rejected"
        return ""

    def _faces(self, obj: Instance, pose: SE2, turn_ended: bool) -> bool:
        """Return True if the robot faces an object, or its turn has ended; else turn it, once."""
        if self.turn is not None:
            return turn_ended
        bearing_rad = pose.bearing_to(*obj.center_m[:2].tolist())
        if abs(bearing_rad) > FACING_RAD:
            self.turn = SE2(pose.x_m, pose.y_m, pose.yaw_rad + bearing_rad)
        return self.turn is None
