"""A robot that obeys a service, in one process: it replays the same with any sensors."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from small_house import small_house

from edge.config import parse
from edge.lab.eval.closed_loop import ClosedLoop, wants_colour

LIDAR = {
    "sensors": {
        "lidar": {"rings": 16, "columns": 360, "vfov_deg": 60, "z_m": 0.6, "pitch_deg": 23}
    },
    "mapping": {"input": "cloud"},
}
ONE_RING = {  # of config/turtlebot4.yaml
    "sensors": {"lidar": {"rings": 1, "columns": 640, "x_m": -0.04, "z_m": 0.1929, "yaw_deg": 90}},
    "mapping": {"input": "cloud"},
}
OPENAI = {"kind": "openai", "url": "http://127.0.0.1:1/v1", "model": "m"}


def trail(loop: ClosedLoop, seconds: float) -> list[tuple[float, float, float]]:
    poses = []
    while loop.seconds < seconds and not loop.service.status.done:
        loop.step()
        pose = loop.drive.motion.pose
        poses.append((pose.x_m, pose.y_m, pose.yaw_rad))
    return poses


@pytest.mark.parametrize("sections", [{}, LIDAR, ONE_RING], ids=["depth", "lidar", "one ring"])
def test_an_episode_replays_identically_and_reaches_the_target(tmp_path, sections):
    config = small_house(tmp_path, mission={"target": "bed"}, **sections)
    loops = [ClosedLoop(config, colour=colour) for colour in (True, False)]
    one, other = (trail(loop, 60.0) for loop in loops)
    assert one == other
    assert loops[0].service.status.phase == "reached"
    assert loops[0].distance_m("bed") <= 1.0


BACK = {"width_px": 96, "height_px": 64, "yaw_deg": 180.0, "x_m": -0.1, "pitch_deg": 10.0}


@pytest.mark.parametrize(
    ("second", "mapped"), [(None, "depth"), (BACK, "depth"), (None, "cloud"), (BACK, "cloud")]
)
def test_a_second_camera_finds_an_object_behind_the_robot(tmp_path, second, mapped):
    """The robot stands with its back to the bed, then drives there."""
    lidar = {"z_m": 0.4, "pitch_deg": 15.0} if mapped == "cloud" else None
    config = small_house(
        tmp_path, mission={"target": "bed"}, sim={"start": [4.8, 2.0, math.pi]},
        sensors={"camera": {"width_px": 80, "height_px": 64}, "second_camera": second,
                 "lidar": lidar},
        mapping={"input": mapped},
    )  # fmt: skip
    loop = ClosedLoop(config, colour=False)
    service = loop.service
    service.control.pause(True, 0)
    loop.run(3.0)
    instances = service.map.tracker.of("bed")
    assert loop.drive.motion.path_m == pytest.approx(0.0, abs=0.01)
    assert bool(instances) == (second is not None)
    for bed in instances:
        assert math.dist(bed.center_m[:2], (6.8, 2.0)) < 1.2
    grid = service.map.grid.snapshot()
    x_m = grid.origin_xy_m[0] + grid.resolution_m * np.nonzero(grid.cells == 100)[1]
    assert x_m.min() < 4.1, "the wall ahead"
    assert (x_m.max() > 5.6) == bool(second or lidar), "the bed, in the same map"
    service.control.pause(False, loop.drive.motion.stamp_ns)
    loop.run(60.0)
    assert (service.status.phase, service.plausibility.failed) == ("reached", ())
    assert loop.distance_m("bed") <= 1.0


@pytest.mark.parametrize(("rate_hz", "ticks"), [(30.0, 20), (10.0, 20), (7.0, 14), (5.0, 10)])
def test_frames_come_at_the_rate_of_the_camera(tmp_path, rate_hz, ticks):
    camera = {"width_px": 32, "height_px": 24, "rate_hz": rate_hz}
    results: list[object] = []
    sink = SimpleNamespace(tick=results.append, close=lambda: None)
    loop = ClosedLoop(small_house(tmp_path, sensors={"camera": camera}), sinks=[sink])
    for _ in range(20):  # 2 s in steps of 0.1 s
        loop.step()
    assert len(results) == ticks
    assert loop.seconds == pytest.approx(2.0)


def test_a_shared_world_keeps_separate_starts(tmp_path):
    config = small_house(tmp_path)
    first = ClosedLoop(config)
    moved = config.model_copy(update={"sim": config.sim.model_copy(update={"start": (3, 1, 1)})})
    second = ClosedLoop(moved, world=first.world)
    assert second.world is first.world
    assert second.drive.motion.pose.x_m == 3.0
    assert first.world.start.x_m == 1.0


@pytest.mark.parametrize(
    ("sections", "wants"),
    [
        ({"perception": {"detector": {"kind": "sim"}}}, False),
        ({"perception": {"detector": {"kind": "onnx"}}}, True),
        ({"perception": {"detector": {"kind": "sim"}, "similarity": "x"}}, True),
        ({"perception": {"detector": {"kind": "sim"}, "choice": OPENAI}}, True),
        (
            {"perception": {"detector": {"kind": "sim"}, "choice": {**OPENAI, "kind": "text"}}},
            False,
        ),
        ({"perception": {"detector": {"kind": "sim"}}, "policy": {"kind": "own:Policy"}}, True),
    ],
)
def test_images_are_rendered_only_if_something_reads_them(sections, wants):
    assert wants_colour(parse(sections)) == wants
