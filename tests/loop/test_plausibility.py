"""The plausibility stage: implausible data stop the robot, with a reason, until they recover."""

from __future__ import annotations

import logging
import math
import re
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import simulated

from edge.config import Config
from edge.geometry import SE2, CameraModel, se3, to_optical
from edge.lab.eval.closed_loop import START_NS, ClosedLoop
from edge.loop.checks.plausibility import LOG_AGAIN_NS, REPORT_AFTER_NS, Plausibility
from edge.loop.semantic_map import SemanticMap
from edge.types import Observation

PAGE = Path(__file__).parents[2] / "docs/robot.md"
CAMERA = CameraModel.from_hfov(64, 48, math.radians(70))
CONFIG = simulated({"sensors": {"camera": {"z_m": 0.4, "pitch_deg": 10.0}}})
T_BASE_CAMERA = CONFIG.sensors.camera.T_base_camera()
CLOUDS = simulated({"sensors": {"lidar": {}}, "mapping": {"input": "cloud"}})
TICK_NS = 100_000_000
HOME = SE2(0, 0, 0)
Tamper = Callable[[Observation], Observation]
SMALL = {"width_px": 160, "height_px": 128, "rate_hz": 10.0}


def driving(**sections: Any) -> ClosedLoop:
    """Return a robot at speed in a house without its target."""
    data = {
        "loop": {"lockstep": True}, "mission": {"target": "surfboard"},
        "sensors": {"camera": SMALL}, **sections,
    }  # fmt: skip
    loop = ClosedLoop(simulated(data))
    while loop.drive.motion.v_mps < 0.45:
        loop.step()
    return loop


def tampered(loop: ClosedLoop, tamper: Tamper) -> Callable[[], None]:
    """Tamper with the loop's data; return a function that restores them."""
    true = loop.observe
    loop.observe = lambda: tamper(true())
    return lambda: setattr(loop, "observe", true)


def always(**fields: Callable[[Observation], np.ndarray]) -> Callable[[], Tamper]:
    return lambda: lambda seen: replace(seen, **{k: make(seen) for k, make in fields.items()})


def frozen(*fields: str) -> Callable[[], Tamper]:
    """Repeat the first of these arrays."""

    def make() -> Tamper:
        first: dict[str, np.ndarray] = {}

        def tamper(seen: Observation) -> Observation:
            for name in fields:
                first.setdefault(name, getattr(seen, name).copy())
            return replace(seen, **first)

        return tamper

    return make


def late(frames: int) -> Callable[[], Tamper]:
    """Observations of so many frames ago, under their own stamps."""

    def make() -> Tamper:
        kept: deque[Observation] = deque(maxlen=frames + 1)

        def tamper(seen: Observation) -> Observation:
            kept.append(replace(seen, rgb=seen.rgb.copy(), depth_m=seen.depth_m.copy()))
            return replace(kept[0], lag_ns=seen.stamp_ns - kept[0].stamp_ns)

        return tamper

    return make


TAMPERED = {
    "frozen": (frozen("rgb", "depth_m"), "camera/depth: no pixel has changed"),
    "colour frozen": (frozen("rgb"), "camera/rgb: no pixel has changed"),
    "depth zero": (always(depth_m=lambda o: np.zeros_like(o.depth_m)), "camera/depth: only 0.0%"),
    "late": (late(20), "sensors: frames arrive"),
}  # fmt: skip


@pytest.mark.parametrize(("make", "why"), TAMPERED.values(), ids=TAMPERED)
def test_implausible_data_stop_the_robot_until_they_recover(make, why):
    loop = driving()
    before, begun_s, path_m, stood = len(loop.notes.events), loop.seconds, 0.0, None
    restore = tampered(loop, make())
    last = loop.drive.motion.pose
    while loop.seconds < begun_s + 6.0:
        loop.step()
        motion = loop.drive.motion
        path_m += math.dist((motion.pose.x_m, motion.pose.y_m), (last.x_m, last.y_m))
        last = motion.pose
        if stood is None and motion.v_mps == 0.0 and loop.service.goals.goal is None:
            stood = loop.seconds - begun_s, path_m
    assert stood is not None
    assert stood[0] <= 1.5 or stood[1] <= 0.5
    assert path_m - stood[1] < 0.1, "it drove on, or back"
    assert any(why in event and "standing still" in event for event in loop.notes.events[before:])
    restore()
    while loop.drive.motion.v_mps < 0.3 and loop.seconds < begun_s + 30.0:
        loop.step()
    assert loop.drive.motion.v_mps >= 0.3
    assert loop.service.plausibility.failed == ()


@pytest.mark.parametrize("frozen_camera", [0, 1])
def test_only_a_frozen_first_camera_stops_the_robot(frozen_camera):
    """The robot stops if the first freezes; it reports the second and drives on."""
    loop = driving(sensors={"camera": SMALL, "second_camera": {**SMALL, "yaw_deg": 180.0}})
    assert loop.service.plausibility.failed == ()
    freeze, begun_s, begun_m = frozen("rgb", "depth_m")(), loop.seconds, loop.drive.motion.path_m
    tampered(loop, lambda seen: freeze(seen) if seen.camera_index == frozen_camera else seen)
    while loop.seconds < begun_s + 5.0:
        loop.step()
    driven_m = loop.drive.motion.path_m - begun_m
    assert driven_m < 0.6 if frozen_camera == 0 else driven_m > 1.0
    name = ("depth_frozen", "camera2_depth_frozen")[frozen_camera]
    assert name in [found.name for found in loop.service.plausibility.failed]
    topic = ("camera", "camera2")[frozen_camera]
    assert any(event.startswith(f"{topic}/depth: no pixel") for event in loop.notes.events)


def test_a_lidar_that_freezes_is_noticed_with_each_camera():
    sensors = {"camera": SMALL, "second_camera": {**SMALL, "yaw_deg": 180.0},
               "lidar": {"z_m": 0.4, "pitch_deg": 15.0}}  # fmt: skip
    loop = driving(sensors=sensors, mapping={"input": "cloud"})
    freeze, begun_s, begun_m = frozen("cloud_m")(), loop.seconds, loop.drive.motion.path_m
    tampered(loop, freeze)
    while loop.seconds < begun_s + 5.0:
        loop.step()
    assert loop.drive.motion.path_m - begun_m < 0.6
    assert [found.name for found in loop.service.plausibility.failed] == ["cloud_frozen"]


@pytest.mark.parametrize(("seed", "begin_s"), [(0, 0.0), (1, 6.0), (2, 6.0)])
def test_delayed_images_are_noticed_by_their_motion(seed, begin_s):
    """A straight drive proves nothing; the next turn or stop does."""
    world = {"kind": "generated", "seed": seed}
    loop = ClosedLoop(simulated({
        "loop": {"lockstep": True}, "mission": {"target": "surfboard"},
        "sensors": {"camera": SMALL}, "sim": {"world": world},
    }), colour=False)  # fmt: skip
    past: deque[np.ndarray] = deque(maxlen=21)
    true = loop.observe

    def late_images() -> Observation:
        seen = true()
        past.append(seen.depth_m.copy())
        return replace(seen, depth_m=past[0]) if loop.seconds >= begin_s else seen

    loop.observe = late_images
    path_m, last = 0.0, loop.drive.motion.pose
    while loop.seconds < begin_s + 12.0:
        loop.step()
        pose = loop.drive.motion.pose
        if loop.seconds > begin_s:
            path_m += math.dist((pose.x_m, pose.y_m), (last.x_m, last.y_m))
        last = pose
    assert path_m < 1.4  # five images are compared
    assert any("do not move as the pose does" in event for event in loop.notes.events)


# -- one check at a time ---------------------------------------------------------------------------


def room(x_m: float = 0.0) -> dict[str, Any]:
    """Return a coloured floor and a wall 4 m away, from a robot that has driven this far."""
    row = (np.arange(48) - CAMERA.cy_px) / CAMERA.fy_px
    down = -(T_BASE_CAMERA[2, 1] * row + T_BASE_CAMERA[2, 2])
    depth_m = np.minimum(0.4 / np.maximum(down, 1e-3), 4.0 - x_m).astype(np.float32)
    rgb = np.arange(48 * 64 * 3, dtype=np.uint32).reshape(48, 64, 3) % 251
    return {
        "rgb": rgb.astype(np.uint8), "depth_m": np.repeat(depth_m[:, None], 64, axis=1),
        "camera": CAMERA, "T_base_camera": T_BASE_CAMERA,
    }  # fmt: skip


def floor(z_m: float | None) -> dict[str, Any]:
    """Return a level floor below or above the base, from a tilted camera; None: no return."""
    T = to_optical(se3(0.1, 0.0, 0.6, pitch_rad=0.3))
    fall = -(T[2, 1] * (np.arange(48) - CAMERA.cy_px) / CAMERA.fy_px + T[2, 2])
    depth = np.full(48, np.nan)
    if z_m is not None:
        depth[fall > 0] = (0.6 - z_m) / fall[fall > 0]
    image = np.repeat(depth[:, None], 64, axis=1).astype(np.float32)
    return {"depth_m": image, "camera": CAMERA, "T_base_camera": T}


class Judge:
    def __init__(self, config: Config = CONFIG) -> None:
        self.said: list[tuple[str, int]] = []
        self.stage = Plausibility(config, self._say)
        self.now_ns = START_NS

    def _say(self, text: str, now_ns: int, level: int) -> None:
        self.said.append((text, level))

    def see(self, pose: SE2 = HOME, after_ns: int = TICK_NS, **fields: Any) -> str:
        """Judge the next observation; return "" if it is good."""
        self.now_ns += after_ns
        seen = Observation(0, self.now_ns, pose.matrix(), **fields)
        return self.stage.permitted_use(seen, self.now_ns)

    def failing(self) -> list[str]:
        return [found.name for found in self.stage.failed]


def test_a_room_is_believed():
    judge, rng = Judge(), np.random.default_rng(1)
    for i in range(20):
        fields = room(0.05 * i)
        fields["rgb"][i % 48] += rng.integers(0, 9, (64, 3)).astype(np.uint8)
        fields["depth_m"][i % 48] += np.float32(0.001)
        assert judge.see(SE2(0.05 * i, 0, 0), **fields) == ""
    assert judge.said == []


BODY = np.array([[1.0, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0.4], [0, 0, 0, 1]])
DOWN = np.array([[0, -1.0, 0, 0.1], [-1, 0, 0, 0], [0, 0, -1, 0.4], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("name", "value", "check", "use"),
    [
        ("depth_m", lambda d: d * 0, "depth_empty", "none"),
        ("depth_m", lambda d: d * np.inf, "depth_empty", "none"),
        ("depth_m", lambda d: np.where(np.arange(64) < 1, d, 0), "depth_empty", "none"),
        ("depth_m", lambda d: np.where(np.arange(64) < 8, d, np.nan), None, ""),
        ("depth_m", lambda d: d * 1000, "depth_unit", "none"),
        ("depth_m", lambda d: d * 100, "depth_unit", "none"),
        ("depth_m", lambda d: d * 10, "depth_unit", "none"),
        ("depth_m", lambda d: d * 3, None, ""),  # a floor 0.8 m below the base may be one
        ("depth_m", lambda d: d * 0.3, None, ""),
        ("rgb", lambda a: a * 0, "rgb_covered", "map"),
        ("rgb", lambda a: a * 0 + 200 + a % 2, "rgb_covered", "map"),
        ("rgb", lambda a: a // 16, "rgb_dark", "map"),
        ("T_base_camera", lambda T: BODY, "camera_axis", ""),
        ("T_base_camera", lambda T: DOWN, "camera_axis", ""),
        ("lag_ns", lambda _: 900_000_000, "late", "map"),
        ("lag_ns", lambda _: 700_000_000, None, ""),
        ("pose_age_ns", lambda _: 200_000_000, "pose_age", ""),
        ("pose_age_ns", lambda _: 20_000_000, None, ""),
    ],
)
def test_each_check_fails_by_its_own_fault(name, value, check, use):
    fields, judge = room() | {"lag_ns": 0, "pose_age_ns": 0}, Judge()
    fields[name] = np.asarray(value(fields[name])).astype(getattr(fields[name], "dtype", int))
    for field in ("lag_ns", "pose_age_ns"):
        fields[field] = int(fields[field])
    for _ in range(7):
        found = judge.see(**fields)
    assert found == use
    assert [f for f in judge.failing() if f != "rgb_dark" or check == f] == [check] * bool(check)


def test_a_missing_floor_makes_the_robot_not_ready():
    judge, known = Judge(), SemanticMap(CONFIG, ("bed",))
    states = []
    for floor_z_m in (None, -2.0, -2.0, None, -2.0, 0.0, 0.0, None):
        seen = Observation(0, judge.now_ns, np.eye(4), **floor(floor_z_m))
        judge.stage.on_mapped(known.update(seen, judge.now_ns))
        for _ in range(7):
            judge.see(**room())
        states.append("floor" in judge.failing())
    known.close()
    assert states == [False, True, True, True, True, False, False, False]
    assert [line[:13] for line, _ in judge.said] == ["map: no floor", "floor: this c"]


def test_near_a_wall_the_robot_may_only_turn_away():
    judge, near, far = Judge(), room(3.5) | {"rgb": None}, room(2.0) | {"rgb": None}
    empty = near | {"depth_m": np.zeros((48, 64), np.float32)}
    assert judge.see(SE2(3.5, 0, 0), **near) == ""
    for yaw_rad in (0.0, 0.5, 1.0):
        assert judge.see(SE2(3.55, 0, yaw_rad), **empty) == ""
    assert judge.see(SE2(3.75, 0, 1.0), **empty) == "none"
    assert judge.see(SE2(3.5, 0, 2.0), **far) == ""
    assert judge.see(SE2(3.5, 0, 2.0), **empty) == "none", "nothing was close any more"


@pytest.mark.parametrize("axis", ["drive", "turn"])
@pytest.mark.parametrize("buffers", [1, 2, 4])
def test_frames_that_repeat_while_the_robot_moves_are_frozen(axis, buffers):
    judge, frames = Judge(), [room() for _ in range(buffers)]
    for i, frame in enumerate(frames):
        frame["depth_m"] += np.float32(0.01 * i)
    found = []
    for i in range(30):
        pose = SE2(0.03 * i, 0, 0) if axis == "drive" else SE2(0, 0, 0.03 * i)
        found.append(judge.see(pose, **frames[i % buffers]))
    assert found[:buffers] == [""] * buffers
    assert found[-1] == "none"
    assert "depth_frozen" in judge.failing()
    nearer_m = room()["depth_m"] - np.float32(0.1)
    assert judge.see(pose, **room() | {"depth_m": nearer_m}) == "map", "the colours repeat"


@pytest.mark.parametrize(
    "poses",
    [
        [SE2(0.001 * (i % 5), 0, 0) for i in range(40)],
        [SE2(0.3 * (i >= 20), 0, 0.2 * (i >= 20)) for i in range(40)],
    ],
    ids=["jitters", "is corrected"],
)
def test_a_standing_robot_may_repeat_its_images(poses):
    judge = Judge()
    assert [judge.see(pose, **room()) for pose in poses] == [""] * len(poses)


@pytest.mark.parametrize(
    ("cloud_m", "check"),
    [
        (np.zeros((0, 3)), ["cloud_empty"]),
        (np.zeros((40, 3)), ["cloud_empty"]),
        (np.ones((40, 3)), ["cloud_frozen"]),
        (np.full((40, 3), (20.0, 0.0, np.inf)), []),  # beams that met nothing
    ],
)
def test_clouds_are_checked_if_they_are_mapped(cloud_m, check):
    judge = Judge(CLOUDS)
    for i in range(20):
        found = judge.see(SE2(0.03 * i, 0, 0), cloud_m=cloud_m.astype(np.float32))
    assert (found, judge.failing()) == ("none" if check else "", check)


def test_a_lasting_fault_is_reported_at_intervals():
    judge = Judge()
    bad = room() | {"depth_m": np.zeros((48, 64), np.float32)}
    judge.see(**bad)
    assert judge.said == []
    assert judge.stage.why("stand").startswith("camera/depth: only 0.0%")
    judge.see(after_ns=REPORT_AFTER_NS, **bad)
    line = (
        "camera/depth: only 0.0% of the pixels have a value: uncover the camera, restart the "
        "camera driver, or correct the depth's unit"
    )
    assert judge.said == [(line, logging.WARNING)]
    judge.see(**room())
    again = "depth_empty: this check of the sensor data passes again"
    assert judge.said[1:] == [(again, logging.INFO)]
    assert judge.stage.status() == {"state": "ok", "failed": {}, "refused": {
        name: 2 * (name == "depth_empty") for name in judge.stage.refused}}  # fmt: skip
    for after_ns, lines in ((REPORT_AFTER_NS, 0), (LOG_AGAIN_NS, 1)):
        judge.see(after_ns=after_ns, **room())
        judge.said.clear()
        judge.see(**bad)
        judge.see(after_ns=REPORT_AFTER_NS, **bad)
        assert judge.said == [(line, logging.WARNING)] * lines


def test_the_page_has_every_check():
    """Each row of the table: name, consequence."""
    lidar = Plausibility(CLOUDS, print).checks
    rows = re.findall(r"^\| `(\w+)` \| .* \| (warn|degrade|stand) \|$", PAGE.read_text(), re.M)
    found = {check.name: check.then for check in (*Judge().stage.checks, *lidar)}
    assert dict(rows) == found
