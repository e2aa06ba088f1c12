"""Checks of `edge doctor --live`: listens to the configured sensors and checks their data."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence

import numpy as np

from edge.bus.session import BusError, ConnectInterrupted, zenoh_session
from edge.cli.findings import Finding, Level, fail, ok, ok_or_warn, warn
from edge.config import Config
from edge.geometry import FARTHEST_M
from edge.loop.checks.plausibility import FailedCheck, Plausibility
from edge.loop.source import InputStatus, Source, missing_inputs
from edge.sources import find_source
from edge.types import CAMERAS, Observation

_WAIT_S = 0.1  # for one observation
_SLOWEST, _FASTEST = 0.7, 1.5  # tolerated rates, as shares of the configured rate
_DROPPED = 0.05  # tolerated share of dropped messages
_OLD_S = 0.5  # tolerated age of a frame
_AHEAD_S = 0.05  # tolerated time by which a stamp is in the future
_FLOOR_M = 0.1  # tolerated height of the lowest points above or below the floor
_LOWEST = 10  # percentile of heights that counts as floor; lower ones are noise and stairs
_STEEP = 0.25  # rays that fall by at least this much per metre see the floor, if it is free
_STRIDE = 8  # every eighth row and column of the depth image is checked
# `Observation.distortion` → text after the camera's angle of view.
_LENS = {"none": "", "rectified": ", rectified", "ignored": ", distortion ignored"}


def check_live_sensors(config: Config, seconds: float) -> list[Finding]:
    """Listen to the sensors for `seconds`, and return the findings."""
    time_is_over = threading.Event()
    timer = threading.Timer(seconds, time_is_over.set)
    timer.daemon = True
    timer.start()
    try:
        with zenoh_session(config.zenoh, "listen", time_is_over) as session:
            source = find_source(config)(config=config, session=session)
            try:
                measurements = _SensorMeasurements(config)
                while not time_is_over.is_set():
                    measurements.measure_next(source)
                return [*measurements.findings(getattr(source, "input_table", tuple)())]
            finally:
                source.close()
    except ConnectInterrupted:
        what = f"zenoh.endpoint: no Zenoh router answers at {config.zenoh.address}"
        return [fail(what, "start the router, or correct the endpoint")]
    except BusError as error:
        todo = "stop the service that uses the endpoint, or see its `/readyz` or live view instead"
        return [fail(str(error), todo)]
    finally:
        timer.cancel()


class _SensorMeasurements:
    """Measurements of the sensor data, collected over all observations."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._checks = Plausibility(config, lambda text, now_ns, level: None)
        self._failed: dict[str, FailedCheck] = {}  # by name of the check
        # One value for each observation: its age at arrival; how much newer the newest pose is;
        # share of depth pixels with a value; height of the floor.
        self._age_s: list[float] = []
        self._lag_s: list[float] = []
        self._valid_shares: list[float] = []
        self._lowest_m: list[float] = []
        self._newest: dict[int, Observation] = {}  # by camera

    def measure_next(self, source: Source) -> None:
        """Wait 0.1 s for the next observation, and measure it."""
        source.wait(_WAIT_S)
        observation = source.poll()
        if observation is None:
            return
        try:
            self._checks.permitted_use(observation, time.monotonic_ns())
            for found in self._checks.failed:
                self._failed.setdefault(found.name, found)
            self._age_s.append((time.time_ns() - observation.stamp_ns) * 1e-9)
            self._lag_s.append(observation.lag_ns * 1e-9)
            self._valid_shares.append(self._checks.meter.facts.depth_valid)
            if (heights_m := _floor_heights(observation)).size:
                self._lowest_m.append(float(np.percentile(heights_m, _LOWEST)))
            self._newest[observation.camera_index] = observation
        finally:
            observation.release()

    def findings(self, rows: Sequence[InputStatus]) -> Iterator[Finding]:
        """Yield a line for each input, then for stamps, mounts, depth, floor and failed checks."""
        for row in rows:
            yield from _check_input(row)
        if not self._newest:
            same_time = "no frame has image, depth or cloud, and pose of the same time"
            why = missing_inputs(rows) or same_time
            yield fail(f"sensors give no observation: {why}", "see docs/robot.md, step 5")
            return
        yield from _check_stamps(float(np.median(self._age_s)), float(np.median(self._lag_s)))
        for _, observation in sorted(self._newest.items()):
            yield from self._check_mounts(observation)
        yield from self._check_floor()
        for found in self._failed.values():
            level: Level = "warn" if found.then == "warn" else "fail"
            yield Finding(level, found.what, found.todo)

    def _check_mounts(self, observation: Observation) -> Iterator[Finding]:
        """Yield size, mount and valid depth of the sensors; nothing is judged here."""
        if observation.camera is not None:
            camera = observation.camera
            mount = _describe_mount(observation.T_base_camera, observation.T_base_camera[:3, 2])
            size = f"{camera.width_px}x{camera.height_px} px, {np.degrees(camera.hfov_rad):.0f}°"
            lens = _LENS[observation.distortion]
            yield ok(f"{CAMERAS[observation.camera_index]}: {size} wide{lens}; {mount}")
        if observation.cloud_m is not None:
            mount = _describe_mount(observation.T_base_lidar, observation.T_base_lidar[:3, 0])
            yield ok(f"lidar: {len(observation.cloud_m)} points; {mount}")
        if observation.depth_m is not None and observation.camera_index == 0:
            valid = np.nanmean(self._valid_shares)
            yield ok(f"depth: {valid:.0%} of the pixels have a value")

    def _check_floor(self) -> Iterator[Finding]:
        """Check that the floor is measured at the height of the base frame."""
        if not self._lowest_m:
            yield ok("floor: not checked, because no sensor looks down at the floor")
            return
        lowest_m = float(np.median(self._lowest_m))
        what = f"floor: measured at {lowest_m:+.2f} m in the base frame, expected at 0 m"
        todo = "correct height and pitch of the sensor mount, the base frame or the depth unit"
        todo += "; or point the sensor at open floor"
        yield ok_or_warn(abs(lowest_m) <= _FLOOR_M, what, todo)


def _check_input(row: InputStatus) -> Iterator[Finding]:
    """Yield the findings on the rate of one input, and on its dropped messages."""
    if row.state == "unused":
        return
    if row.state == "missing":
        todo = "start the driver that sends it, or correct the key or topic name"
        what = f"{row}: no message"
        yield fail(what, todo) if row.needed else ok(what)
        return
    rate = f"{row}: {row.hz:g} Hz" if row.expected_hz else f"{row}: {row.received} messages"
    if row.is_lacking:
        todo = "see docs/robot.md, step 5" if row.why else "restart the driver that sends it"
        yield fail(f"{rate}, {row.state}{row.why and f': {row.why}'}", todo)
        return
    expected = row.expected_hz
    if expected and not _SLOWEST * expected <= row.hz <= _FASTEST * expected:
        todo = "correct the rate of the driver, or the rate under sensors in the configuration"
        yield warn(f"{rate}, configured: {expected:g} Hz", todo)
    else:
        yield ok(rate)
    for reason, n in row.dropped.items():
        if reason != "superseded" and n > _DROPPED * row.received:
            share = n / max(row.received, 1)
            yield warn(f"{row}: {share:.0%} dropped: {reason}", "see the log lines above")


def _check_stamps(age_s: float, lag_s: float) -> Iterator[Finding]:
    """Check that frames are neither old nor in the future."""
    what = f"stamps: frames are {age_s:.2f} s old when the service gets them"
    todo = "synchronise the clocks of the computers (chrony), or speed up the driver or the network"
    yield ok_or_warn(-_AHEAD_S <= age_s <= _OLD_S, what, todo)
    yield ok(f"poses: the newest pose is {lag_s:.2f} s newer than the newest frame")


def _describe_mount(T_base_sensor: np.ndarray, axis: np.ndarray) -> str:
    """Return in words the position of a sensor, and the direction `axis` in which it looks."""
    x, y, z = T_base_sensor[:3, 3]
    pitch_deg = np.degrees(np.arcsin(np.clip(-axis[2], -1.0, 1.0)))
    yaw_deg = np.degrees(np.arctan2(axis[1], axis[0]))
    where = f"at ({x:.2f}, {y:.2f}, {z:.2f}) m on the base"
    side, height = "left" if yaw_deg >= 0 else "right", "down" if pitch_deg >= 0 else "up"
    return f"{where}, looks {abs(yaw_deg):.0f}° to the {side} and {abs(pitch_deg):.0f}° {height}"


def _floor_heights(observation: Observation) -> np.ndarray:
    """Return the heights of points that a sensor sees steeply below itself.

    Returns:
        Heights above the base frame in m, (n,).
    """
    if observation.depth_m is not None and observation.camera is not None:
        camera, T = observation.camera, observation.T_base_camera
        depth_m = observation.depth_m[::_STRIDE, ::_STRIDE]
        # Of each pixel, y / z and x / z of its ray in the camera's frame.
        row = (np.arange(0, observation.depth_m.shape[0], _STRIDE) - camera.cy_px) / camera.fy_px
        column = (np.arange(0, observation.depth_m.shape[1], _STRIDE) - camera.cx_px) / camera.fx_px
        # Distance by which the ray falls in the base frame, per metre of depth.
        down = -(T[2, 0] * column[None, :] + T[2, 1] * row[:, None] + T[2, 2])
        is_used = (depth_m > 0.0) & (depth_m < FARTHEST_M) & (down >= _STEEP)
        return T[2, 3] - depth_m[is_used] * down[is_used]
    if observation.cloud_m is None:
        return np.empty(0)
    T = observation.T_base_lidar
    # Height of each point above the LiDAR; negative below it.
    fall = observation.cloud_m @ T[2, :3].astype(np.float32)
    steep = -fall >= _STEEP * np.linalg.norm(observation.cloud_m, axis=1)
    return T[2, 3] + fall[steep & (fall < 0.0) & np.isfinite(fall)]
