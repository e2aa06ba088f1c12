"""Checks of `edge doctor --live`: listens to the configured sensors and checks their data."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence

import numpy as np

from edge.bus.session import BusError, ConnectInterrupted, zenoh_session
from edge.cli.machine_checks import Finding, Level
from edge.config import Config
from edge.geometry import FARTHEST_M
from edge.loop.plausibility import FailedCheck, Plausibility
from edge.loop.source import InputStatus, Source, missing_inputs
from edge.sources import find_source
from edge.types import Observation

_PATIENCE_S = 0.1
_SLOW, _FAST = 0.7, 1.5  # tolerated share of the configured rate
_DROPPED = 0.05  # tolerated share of dropped messages
_OLD_S, _AHEAD_S = 0.5, 0.05
_FLOOR_M = 0.1  # tolerated height of the lowest points above or below the floor
_LOWEST = 10  # percentile of heights that counts as floor; lower ones are noise and stairs
_STEEP = 0.25  # rays that fall by at least this much per metre see the floor, if it is free
_STRIDE = 8
_LENS = {"none": "", "rectified": ", rectified", "ignored": ", distortion ignored"}


def check_live_sensors(config: Config, seconds: float) -> list[Finding]:
    """Listen to the sensors for `seconds`, and return the findings."""
    over = threading.Event()
    timer = threading.Timer(seconds, over.set)
    timer.daemon = True
    timer.start()
    try:
        with zenoh_session(config.zenoh, "listen", over) as session:
            source = find_source(config)(config=config, session=session)
            try:
                heard = _Heard(config)
                while not over.is_set():
                    heard.take(source)
                return [*heard.findings(getattr(source, "input_table", tuple)())]
            finally:
                source.close()
    except ConnectInterrupted:
        what = f"zenoh.endpoint: no Zenoh router answers at {config.zenoh.address}"
        return [Finding("fail", what, "start the router, or correct the endpoint")]
    except BusError as error:
        todo = "stop the service that uses the endpoint, or see its `/readyz` or live view instead"
        return [Finding("fail", str(error), todo)]
    finally:
        timer.cancel()


class _Heard:
    """Measurements of the sensor data, collected over all observations."""

    def __init__(self, config: Config) -> None:
        self._config = config
        blind_s = max(config.loop.blind_s, 3.0 / config.observed_hz)
        self._checks = Plausibility(config, blind_s, lambda text, now_ns, level: None)
        self._failed: dict[str, FailedCheck] = {}
        self._age_s: list[float] = []
        self._lag_s: list[float] = []
        self._valid: list[float] = []
        self._lowest_m: list[float] = []
        self._newest: Observation | None = None

    def take(self, source: Source) -> None:
        """Wait 0.1 s for the next observation, and measure it."""
        source.wait(_PATIENCE_S)
        seen = source.poll()
        if seen is None:
            return
        try:
            self._checks.permitted_use(seen, time.monotonic_ns())
            for found in self._checks.failed:
                self._failed.setdefault(found.name, found)
            self._age_s.append((time.time_ns() - seen.stamp_ns) * 1e-9)
            self._lag_s.append(seen.lag_ns * 1e-9)
            self._valid.append(self._checks.facts.depth_valid)
            if (heights_m := _floor_heights(seen)).size:
                self._lowest_m.append(float(np.percentile(heights_m, _LOWEST)))
            self._newest = seen
        finally:
            seen.release()

    def findings(self, rows: Sequence[InputStatus]) -> Iterator[Finding]:
        """Yield a line for each input, then for stamps, mounts, depth, floor and failed checks."""
        for row in rows:
            yield from _input(row)
        if self._newest is None:
            why = (
                missing_inputs(rows)
                or "no frame has image, depth or cloud, and pose of the same time"
            )
            yield Finding(
                "fail", f"sensors give no observation: {why}", "see docs/robot.md, step 5"
            )
            return
        yield from _stamps(float(np.median(self._age_s)), float(np.median(self._lag_s)))
        yield from self._mounts(self._newest)
        yield from self._floor()
        for found in self._failed.values():
            level: Level = "warn" if found.then == "warn" else "fail"
            yield Finding(level, found.what, found.todo)

    def _mounts(self, seen: Observation) -> Iterator[Finding]:
        if seen.camera is not None:
            camera, mount = seen.camera, _mounted(seen.T_base_camera, seen.T_base_camera[:3, 2])
            size = f"{camera.width_px}x{camera.height_px} px, {np.degrees(camera.hfov_rad):.0f}°"
            lens = _LENS[seen.distortion]
            yield Finding("ok", f"camera: {size} wide{lens}; {mount}")
        if seen.cloud_m is not None:
            mount = _mounted(seen.T_base_lidar, seen.T_base_lidar[:3, 0])
            yield Finding("ok", f"lidar: {len(seen.cloud_m)} points; {mount}")
        if seen.depth_m is not None:
            valid = np.nanmean(self._valid)
            yield Finding("ok", f"depth: {valid:.0%} of the pixels have a value")

    def _floor(self) -> Iterator[Finding]:
        if not self._lowest_m:
            yield Finding("ok", "floor: not checked, because no sensor looks down at the floor")
            return
        lowest_m = float(np.median(self._lowest_m))
        what = f"floor: measured at {lowest_m:+.2f} m in the base frame, expected at 0 m"
        if abs(lowest_m) <= _FLOOR_M:
            yield Finding("ok", what)
        else:
            todo = "correct height and pitch of the sensor mount, the base frame or the depth unit"
            yield Finding("warn", what, f"{todo}; or point the sensor at open floor")


def _input(row: InputStatus) -> Iterator[Finding]:
    """Yield the findings on the rate of one input, and on its dropped messages."""
    if row.state == "unused":
        return
    if row.state == "missing":
        level: Level = "fail" if row.needed else "ok"
        todo = (
            "start the driver that sends it, or correct the key or topic name" if row.needed else ""
        )
        yield Finding(level, f"{row}: no message", todo)
        return
    rate = f"{row}: {row.hz:g} Hz" if row.expected_hz else f"{row}: {row.received} messages"
    if row.is_lacking:
        todo = "see docs/robot.md, step 5" if row.why else "restart the driver that sends it"
        yield Finding("fail", f"{rate}, {row.state}{row.why and f': {row.why}'}", todo)
        return
    expected = row.expected_hz
    if expected and not _SLOW * expected <= row.hz <= _FAST * expected:
        todo = "correct the rate of the driver, or the rate under sensors in the configuration"
        yield Finding("warn", f"{rate}, configured: {expected:g} Hz", todo)
    else:
        yield Finding("ok", rate)
    for reason, n in row.dropped.items():
        if reason != "superseded" and n > _DROPPED * row.received:
            share = n / max(row.received, 1)
            yield Finding(
                "warn", f"{row}: {share:.0%} dropped: {reason}", "see the log lines above"
            )


def _stamps(age_s: float, lag_s: float) -> Iterator[Finding]:
    what = f"stamps: frames are {age_s:.2f} s old when the service gets them"
    if -_AHEAD_S <= age_s <= _OLD_S:
        yield Finding("ok", what)
    else:
        todo = (
            "synchronise the clocks of the computers (chrony), or speed up the driver or the "
            "network"
        )
        yield Finding("warn", what, todo)
    yield Finding("ok", f"poses: the newest pose is {lag_s:.2f} s newer than the newest frame")


def _mounted(T_base_sensor: np.ndarray, axis: np.ndarray) -> str:
    """Return the position and direction of a sensor in words."""
    x, y, z = T_base_sensor[:3, 3]
    pitch_deg = np.degrees(np.arcsin(np.clip(-axis[2], -1.0, 1.0)))
    yaw_deg = np.degrees(np.arctan2(axis[1], axis[0]))
    where = f"at ({x:.2f}, {y:.2f}, {z:.2f}) m on the base"
    side, height = "left" if yaw_deg >= 0 else "right", "down" if pitch_deg >= 0 else "up"
    return f"{where}, looks {abs(yaw_deg):.0f}° to the {side} and {abs(pitch_deg):.0f}° {height}"


def _floor_heights(seen: Observation) -> np.ndarray:
    """Return heights above the base frame, in m, of points that a sensor sees steeply below it."""
    if seen.depth_m is not None and seen.camera is not None:
        camera, T = seen.camera, seen.T_base_camera
        depth_m = seen.depth_m[::_STRIDE, ::_STRIDE]
        row = (np.arange(0, seen.depth_m.shape[0], _STRIDE) - camera.cy_px) / camera.fy_px
        column = (np.arange(0, seen.depth_m.shape[1], _STRIDE) - camera.cx_px) / camera.fx_px
        down = -(T[2, 0] * column[None, :] + T[2, 1] * row[:, None] + T[2, 2])
        judged = (depth_m > 0.0) & (depth_m < FARTHEST_M) & (down >= _STEEP)
        return T[2, 3] - depth_m[judged] * down[judged]
    if seen.cloud_m is None:
        return np.empty(0)
    T = seen.T_base_lidar
    fall = seen.cloud_m @ T[2, :3].astype(np.float32)
    steep = -fall >= _STEEP * np.linalg.norm(seen.cloud_m, axis=1)
    return T[2, 3] + fall[steep & (fall < 0.0) & np.isfinite(fall)]
