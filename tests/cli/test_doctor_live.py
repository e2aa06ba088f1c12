"""`edge doctor --live`: one line for each fault of the sensors' data."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated import simulated

from edge.cli import doctor
from edge.cli.findings import Finding
from edge.cli.live_checks import check_live_sensors
from edge.cli.parsers import make_parser
from edge.config import Config
from edge.geometry import SE2, CameraModel
from edge.host.ports import free_port
from edge.loop.source import InputStatus
from edge.types import Observation

CAMERA = CameraModel.from_hfov(64, 48, math.radians(70))
WALL_M = 4.0  # ahead of where the robot starts
MOUNT = {"x_m": 0.1, "z_m": 0.5, "pitch_deg": 15.0, "rate_hz": 10.0}
ROW = InputStatus("camera/depth", "edge/camera/depth", "depth_m", True, "ok", "", 10.0, 10.0, 0.1,
               100, {})  # fmt: skip
Change = Callable[[dict], object]


class Scripted:
    """Source that shows a floor and a wall, or a test's change of them."""

    change: Change = staticmethod(lambda fields: None)
    rows: tuple[InputStatus, ...] = ()

    def __init__(self, config: Config) -> None:
        self.counters: dict[str, int] = {}
        self.inbox = SimpleNamespace(overruns=0, poll=list)
        self.epoch, self.pose = 0, None
        self._T, self._n = config.sensors.camera.T_base_camera(), 0

    def input_table(self) -> tuple[InputStatus, ...]:
        return self.rows

    def poll(self) -> Observation | None:
        rng, T = np.random.default_rng(self._n), self._T
        row = (np.arange(48) - CAMERA.cy_px) / CAMERA.fy_px
        down, ahead = -(T[2, 1] * row + T[2, 2]), T[0, 1] * row + T[0, 2]
        x_m = 0.02 * self._n
        depth_m = np.minimum(0.5 / np.maximum(down, 1e-3), (WALL_M - x_m) / ahead)
        depth_m = np.repeat(depth_m[:, None], 64, axis=1)
        fields = {
            "T_map_base": SE2(x_m, 0.0, 0.0).matrix(),
            "stamp_ns": time.time_ns(), "T_base_camera": T,
            "depth_m": (depth_m + rng.normal(0, 1e-3, depth_m.shape)).astype(np.float32),
            "rgb": rng.integers(0, 255, (48, 64, 3), np.uint8),
        }  # fmt: skip
        if self.change(fields) is None:
            return None
        self._n += 1
        return Observation(self._n, camera=CAMERA, **fields)

    def wait(self, timeout_s: float) -> bool:
        time.sleep(0.01)
        return True

    def close(self) -> None: ...


def put(name: str, change: Callable[[np.ndarray], object]) -> Change:
    return lambda fields: fields.update({name: change(fields[name])}) or fields


@pytest.fixture
def heard(monkeypatch) -> Callable[..., list[tuple[str, str]]]:
    """Return the findings that need an action, as (level, text)."""

    def listened(
        change: Change, rows: tuple[InputStatus, ...] = (ROW,), seconds: float = 0.8
    ) -> list[tuple[str, str]]:
        monkeypatch.setattr(Scripted, "change", staticmethod(change))
        monkeypatch.setattr(Scripted, "rows", rows)
        config = simulated({
            "source": {"kind": f"{__name__}:Scripted"}, "sensors": {"camera": MOUNT},
            "zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
        })  # fmt: skip
        findings = check_live_sensors(config, seconds)
        assert all(bool(found.todo) == (found.level != "ok") for found in findings)
        return [(found.level, found.what) for found in findings if found.level != "ok"]

    return listened


def test_silent_sensors_are_a_failure(heard):
    assert heard(lambda fields: None, ()) == [
        (
            "fail",
            "sensors give no observation: no frame has image, depth or cloud, and pose of "
            "the same "
            "time",
        )
    ]


def test_both_cameras_are_described(monkeypatch):
    seen = iter(range(10**6))

    def alternate(fields: dict) -> dict:
        T = config.sensors.cameras[index := next(seen) % 2].T_base_camera()
        fields.update(camera_index=index, T_base_camera=T)
        return fields

    monkeypatch.setattr(Scripted, "change", staticmethod(alternate))
    config = simulated({
        "source": {"kind": f"{__name__}:Scripted"},
        "sensors": {"camera": MOUNT, "second_camera": {**MOUNT, "yaw_deg": 180.0}},
        "zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
    })  # fmt: skip
    lines = [found.what for found in check_live_sensors(config, 0.8)]
    cameras = [line for line in lines if line.startswith("camera")]
    assert [line.partition(":")[0] for line in cameras] == ["camera", "camera2"]
    assert cameras[0] != cameras[1].replace("camera2", "camera")
    assert sum(line.startswith("depth:") for line in lines) == 1


BODY = np.array([[1.0, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]])
AGO_NS = 3_600_000_000_000


@pytest.mark.parametrize(
    ("change", "level", "says"),
    [
        (put("depth_m", lambda d: d * 1000), "fail", "cannot be in metres"),
        (put("depth_m", lambda d: d * 1.5), "warn", "floor: measured at -0.25 m in the base frame"),
        (put("depth_m", np.zeros_like), "fail", "camera/depth: only 0.0% of the pixels"),
        (put("rgb", np.zeros_like), "fail", "camera/rgb: the image has one colour"),
        (put("rgb", lambda a: np.broadcast_to(np.arange(64, dtype=np.uint8)[:, None], a.shape)),
         "fail", "camera/rgb: no pixel has changed"),
        (put("T_base_camera", lambda T: BODY), "warn", "camera: looks up or down (z +1.00"),
        (put("stamp_ns", lambda ns: ns - AGO_NS), "warn", "stamps: frames are 3600.0"),
    ],
    ids=["millimetres", "low floor", "no depth", "covered", "frozen", "body frame", "clock"],
)  # fmt: skip
def test_each_fault_is_a_line(heard, change, level, says):
    assert level in [given for given, what in heard(change) if says in what]


@pytest.mark.parametrize(
    ("row", "level", "says"),
    [
        ({"state": "missing"}, "fail", "edge/camera/depth: no message"),
        ({"state": "silent"}, "fail", "edge/camera/depth: 10 Hz, silent"),
        ({"state": "dropped", "why": "stale (3 s)"}, "fail", "10 Hz, dropped: stale (3 s)"),
        ({"hz": 4.0}, "warn", "edge/camera/depth: 4 Hz, configured: 10 Hz"),
        ({"dropped": {"malformed": 30}}, "warn", "edge/camera/depth: 30% dropped: malformed"),
        ({"dropped": {"superseded": 90}}, "ok", ""),
        ({"state": "missing", "needed": False}, "ok", ""),
        ({"state": "unused"}, "ok", ""),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_each_input_is_a_line(heard, row, level, says):
    found = heard(lambda fields: fields, (replace(ROW, **row),), 0.2)
    assert [given for given, _ in found] == [level] * (level != "ok")
    assert all(says in what for _, what in found)


@pytest.mark.parametrize(("level", "code"), [("ok", 0), ("warn", 1), ("fail", 1)])
def test_any_warning_gives_exit_code_1(monkeypatch, capsys, level, code):
    monkeypatch.setattr(
        doctor,
        "check_live_sensors",
        lambda config, seconds: [Finding(level, f"heard {seconds:g} s")],
    )
    args = make_parser().parse_args(["doctor", "--live", "demo", "--seconds", "3"])
    assert args.handler(args) == code
    assert "heard 3 s" in capsys.readouterr().out
