"""Plausibility stage: it checks each observation before the map uses it.

`checks_of` is the table of checks: measurement, limits, message and consequence. A refused
observation counts as no observation: the robot stands still after `loop.blind_s`, and `/readyz`
shows the reason.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from edge.config import Config
from edge.loop.checks.depth_motion import MISFIT
from edge.loop.checks.frame_meter import FROZEN_AFTER_M, VALID_SHARE, FrameFacts, FrameMeter
from edge.mapping.results import MapUpdate
from edge.types import Observation

Consequence = Literal["warn", "degrade", "stand"]
"""`warn`: a line in log and status. `degrade`: in addition, `/readyz` is 503. `stand`: in addition,
observations are refused, so the robot stands still after `loop.blind_s`."""
Use = Literal["", "map", "none"]
"""Permitted use of an observation. "": everything (recordings hold this value); `map`: mapping, but
no detection or driving; `none`: nothing."""

REPORT_AFTER_NS = 500_000_000
"""A check that fails for a shorter time is not reported."""
LOG_AGAIN_NS = 30_000_000_000
"""A check that fails again sooner is not logged again."""
_POSE_OLD_S = 0.05  # above it, a wall 2 m away is mapped two cells off at 1 rad/s


@dataclass(frozen=True, slots=True)
class DataCheck:
    """One row of the table of checks.

    Attributes:
        measured: Returns the measured value.
        what: Place and problem, for the user, with `{value}`.
        todo: Advice for the user.
        lowest: The check fails below this value.
        highest: The check fails above this value.
        permits: Use of the observation that a failure still permits. "" if a failure only warns or
            degrades; a check with `stand` gives another value.
        camera_index: Camera whose observations are checked; None: each camera's.
    """

    name: str
    measured: Callable[[FrameFacts], float]
    what: str
    todo: str
    then: Consequence
    lowest: float = -math.inf
    highest: float = math.inf
    permits: Use = ""
    camera_index: int | None = 0


def checks_of(config: Config, blind_s: float) -> tuple[DataCheck, ...]:
    """Return the table of checks for the sensors that a configuration uses."""
    # Each is "depth" or "cloud".
    mapped, back_projected = config.mapping.input, config.perception.back_projection
    # Without the sensor of the map nothing is permitted; without the other one, only mapping.
    permits: dict[str, Use] = {
        kind: "none" if kind == mapped else "map" for kind in ("depth", "cloud")
    }
    frozen = "has changed over {value:.1f} m of driving"
    uncover = "uncover the camera, or restart the camera driver"
    restart = "restart the driver of the sensor"
    unit = "correct the depth's unit (32FC1 is m, 16UC1 is mm) or the camera's mount"
    table = (
        DataCheck("depth_empty", lambda f: f.depth_valid,
                  "camera/depth: only {value:.1%} of the pixels have a value",
                  "uncover the camera, restart the camera driver, or correct the depth's unit",
                  "stand", lowest=VALID_SHARE, permits=permits["depth"]),
        DataCheck("depth_frozen", lambda f: f.depth_driven_m,
                  f"camera/depth: no pixel {frozen}", restart, "stand", highest=FROZEN_AFTER_M,
                  permits=permits["depth"]),
        DataCheck("depth_unit", lambda f: f.depth_scale,
                  "camera/depth: values are {value:.0f} times the distance of the floor, so they "
                  "cannot be in metres", unit, "stand", highest=1.0, permits=permits["depth"]),
        DataCheck("depth_motion", lambda f: f.depth_misfit,
                  "camera/depth: {value:.0%} of the points do not move as the pose does",
                  "check delay and stamps of the images, the odometry, and the camera's mount",
                  "stand", highest=MISFIT, permits=permits["depth"]),
        DataCheck("cloud_empty", lambda f: f.cloud_points, "lidar: no point has a value",
                  "uncover the LiDAR, or restart the LiDAR driver",
                  "stand", lowest=1.0, permits=permits["cloud"]),
        DataCheck("cloud_frozen", lambda f: f.cloud_driven_m, f"lidar: no point {frozen}", restart,
                  "stand", highest=FROZEN_AFTER_M, permits=permits["cloud"]),
        DataCheck("rgb_covered", lambda f: f.rgb_levels,
                  "camera/rgb: the image has one colour ({value:.0f} levels)", uncover,
                  "stand", lowest=3.0, permits="map"),
        DataCheck("rgb_dark", lambda f: f.rgb_level,
                  "camera/rgb: the image is dark (level {value:.0f} of 255)",
                  "uncover the camera, or switch the light on",
                  "stand", lowest=12.0, permits="map"),
        DataCheck("rgb_frozen", lambda f: f.rgb_driven_m, f"camera/rgb: no pixel {frozen}", restart,
                  "stand", highest=FROZEN_AFTER_M, permits="map"),
        DataCheck("late", lambda f: f.late_s,
                  "sensors: frames arrive {value:.1f} s later than the pose of the same time",
                  "speed up the driver or the network", "stand", highest=blind_s, permits="map"),
        DataCheck("camera_axis", lambda f: f.axis_z,
                  "camera: looks up or down (z {value:+.2f} of its axis in the base frame)",
                  "check that the camera's frame is optical (z forward, x right)",
                  "warn", lowest=-0.9, highest=0.7),
        DataCheck("floor", lambda f: f.floor_lost,
                  "map: no floor near the base, but ground far below; nothing is mapped",
                  "check z_m and pitch_deg of the sensor, and the frame of the odometry",
                  "degrade", highest=0.0),
        DataCheck("pose_age", lambda f: f.pose_age_s,
                  "odom: frames are mapped with poses or transforms {value:.2f} s old",
                  "speed up the localization or the network, or raise source.wait_s",
                  "warn", highest=_POSE_OLD_S),
    )  # fmt: skip
    unused = {"depth", "cloud"} - {mapped, back_projected}
    checks = [check for check in table if check.name.partition("_")[0] not in unused]
    if config.sensors.second_camera is not None:
        images = [check for check in checks if "cloud" not in check.name]
        clouds = [replace(check, camera_index=None) for check in checks if check not in images]
        checks = [*images, *clouds, *map(_for_second_camera, images)]
    return tuple(checks)


def _for_second_camera(check: DataCheck) -> DataCheck:
    what = check.what if check.what.startswith("camera") else f"camera: {check.what}"
    what = what.replace("camera", "camera2", 1)
    return replace(check, name=f"camera2_{check.name}", what=what, camera_index=1)


class FailedCheck(NamedTuple):
    """A check that fails on the newest observation.

    Attributes:
        what: Place and problem, for the user.
        todo: Advice for the user.
        since_ns: Loop time of the first failure.
    """

    name: str
    then: Consequence
    what: str
    todo: str
    since_ns: int

    @property
    def message(self) -> str:
        return f"{self.what}: {self.todo}"


class Plausibility:
    """The plausibility stage. The loop's thread calls `permitted_use`.

    Args:
        event: Reports an event for people, at a loop time and a log level.

    Attributes:
        blind_s: Time without an observation after which the robot must stand still.
        meter: Measurements of the newest observation.
        failed: Checks that have failed for at least `REPORT_AFTER_NS`. The tuple is replaced at
            once, so any thread may read it.
        refused: Number of refused observations by check.
    """

    def __init__(self, config: Config, event: Callable[[str, int, int], None]) -> None:
        # At low rates, three periods without an observation are normal.
        self.blind_s = max(config.loop.blind_s, 3.0 / config.observed_hz)
        self.checks = checks_of(config, self.blind_s)
        self.failed: tuple[FailedCheck, ...] = ()
        self.refused = {check.name: 0 for check in self.checks if check.permits}
        self._event = event
        self._found: list[FailedCheck | None] = [None] * len(self.checks)  # failures now, by check
        self._logged_ns: dict[str, int] = {}  # loop time of the newest log line, by check
        self._meters = [FrameMeter(config) for _ in config.sensors.cameras]
        self.meter = self._meters[0]

    def on_mapped(self, update: MapUpdate) -> None:
        """Record whether the map found the floor. Some updates show neither a floor nor a gap."""
        if update.floor_missing or update.floor_seen:
            self.meter.floor_lost = update.floor_missing

    def permitted_use(self, observation: Observation, now_ns: int) -> Use:
        """Check an observation, report what fails, and return the use that is permitted."""
        self.meter = self._meters[observation.camera_index]
        self.meter.measure(observation, now_ns)
        use: Use = ""
        changed = False
        for i, check in enumerate(self.checks):
            if check.camera_index not in (None, observation.camera_index):
                continue
            value, found = check.measured(self.meter.facts), self._found[i]
            if not (value < check.lowest or value > check.highest):
                if found is not None:
                    self._found[i], changed = None, True
                continue
            if found is None:
                what = check.what.format(value=value)
                found = FailedCheck(check.name, check.then, what, check.todo, now_ns)
                self._found[i] = found
            changed = changed or now_ns - found.since_ns >= REPORT_AFTER_NS
            if check.permits:
                self.refused[check.name] += 1
                use = "none" if "none" in (use, check.permits) else "map"
        if changed:
            self._report(now_ns)
        return use

    def _report(self, now_ns: int) -> None:
        """Update `failed`; log the checks that fail now and those that pass again."""
        before = {found.name for found in self.failed}
        lasting = [
            f for f in self._found if f is not None and now_ns - f.since_ns >= REPORT_AFTER_NS
        ]
        for found in lasting:
            logged_ns = self._logged_ns.get(found.name)
            again = logged_ns is None or now_ns - logged_ns >= LOG_AGAIN_NS
            if found.name not in before and again:
                self._logged_ns[found.name] = now_ns
                self._event(found.message, now_ns, logging.WARNING)
        for name in sorted(before - {found.name for found in lasting}):
            self._event(f"{name}: this check of the sensor data passes again", now_ns, logging.INFO)
        self.failed = tuple(lasting)

    def why(self, then: Consequence) -> str:
        """Return the messages of the checks with this consequence that fail, in one line.

        In contrast to `failed`, it holds a failure from its first observation on.
        """
        return "; ".join(f.message for f in self._found if f is not None and f.then == then)

    def status(self) -> dict[str, object]:
        """Return the state for the status message: the worst consequence, and why."""
        worst = {found.then for found in self.failed}
        state = next((then for then in ("stand", "degrade", "warn") if then in worst), "ok")
        return {
            "state": state,
            "failed": {found.name: found.message for found in self.failed},
            "refused": dict(self.refused),
        }
