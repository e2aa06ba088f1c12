"""The table of inputs: which one is missing, silent or of no use, how often it comes, and why."""

from __future__ import annotations

import pytest
from test_sources_synchronizer import FRAME_NS, MS, Robot

from edge.loop.source import InputStatus, inputs_status, missing_inputs


def rows(robot: Robot) -> dict[str, InputStatus]:
    return {row.name: row for row in robot.synchronizer.inputs.rows()}


def states(robot: Robot) -> dict[str, str]:
    return {name: row.state for name, row in rows(robot).items()}


def driven(
    robot: Robot, seconds: float, without: str = "", late: str = "", late_ns: int = 0
) -> Robot:
    """Frames and poses at 30 Hz, each polled for, without one input or with a late one."""
    for _ in range(int(seconds * 30)):
        robot.wait(FRAME_NS)
        if without != "camera/info":
            robot.info()
        for name, send in (("camera/rgb", robot.rgb), ("camera/depth", robot.depth)):
            if name != without:
                send(robot.now_ns - late_ns * (name == late))
        if without != "odom":
            robot.odom(robot.now_ns - late_ns * (late == "odom"))
        if (seen := robot.poll()) is not None:
            seen.release()
    return robot


def test_at_first_every_input_is_missing():
    robot = Robot()
    assert set(states(robot).values()) == {"missing"}
    inputs = robot.synchronizer.inputs
    inputs.listen("camera/rgb", "/camera/color/image_raw")
    inputs.listen("odom", "edge/odom")
    assert missing_inputs(inputs.rows()) == (
        "no message yet on camera/rgb (/camera/color/image_raw), camera/depth, camera/info, "
        "edge/odom"
    )
    status = inputs_status(inputs.rows())
    assert (status["state"], status["topics"]["odom"]["age_s"]) == ("lacking", None)


@pytest.mark.parametrize(
    ("without", "said"),
    [
        # Each of them by itself keeps every frame from becoming an observation.
        ("camera/rgb", "no message yet on camera/rgb; every message on camera/depth is dropped: "
                       "unpaired (no camera/rgb)"),
        ("camera/depth", "no message yet on camera/depth"),
        ("camera/info", "no message yet on camera/info; every message on camera/depth is dropped: "
                        "no_camera_info"),
        ("odom", "no message yet on odom; every message on camera/depth is dropped: no_pose "
                 "(no odom)"),
    ],
)  # fmt: skip
def test_the_only_missing_input_is_named(without, said):
    robot = driven(Robot(), 3, without)
    assert missing_inputs(robot.synchronizer.inputs.rows()) == said


@pytest.mark.parametrize("without", ["camera/rgb", "camera/depth", "odom"])
def test_a_silent_input_is_named_until_it_returns(without):
    robot = driven(driven(Robot(), 3), 3, without)
    row = rows(robot)[without]
    assert (row.state, row.hz) == ("silent", 0.0)
    assert row.age_s == pytest.approx(3.0, abs=0.01)
    assert f"no more messages on {without}" in missing_inputs(robot.synchronizer.inputs.rows())
    assert missing_inputs(driven(robot, 3).synchronizer.inputs.rows()) == ""


@pytest.mark.parametrize(
    ("late", "late_ms", "name", "why"),
    [
        # A frame waits for half a second, in which 15 more come. Then the poses are too old.
        ("odom", 1200, "camera/depth",
         "no_pose (the nearest odom is 667 ms earlier; odom comes 1200 ms after camera/depth of "
         "its stamp, and source.wait_s is 0.5)"),
        ("camera/rgb", 700, "camera/depth",
         "unpaired (the nearest camera/rgb is 167 ms earlier; camera/rgb comes 700 ms after "
         "camera/depth of its stamp, and source.wait_s is 0.5)"),
        ("camera/depth", 1200, "camera/depth",
         "unpaired (the nearest camera/rgb is 1200 ms later; camera/depth comes 1200 ms after "
         "camera/rgb of its stamp, and source.wait_s is 0.5)"),
        ("odom", 450, "camera/depth", ""),
        ("camera/rgb", 450, "camera/depth", ""),
        ("camera/depth", 450, "camera/depth", ""),
    ],
)  # fmt: skip
def test_a_late_input_is_named_with_its_delay(late, late_ms, name, why):
    robot = driven(Robot(), 5, late=late, late_ns=late_ms * MS)
    row = rows(robot)[name]
    assert (row.state, row.why) == ("dropped" if why else "ok", why)
    assert row.dropped.get(why.split(" ")[0], 0) > 50 or not why


def test_old_poses_are_reported():
    robot = driven(Robot(), 5, late="odom", late_ns=700 * MS)
    row = rows(robot)["odom"]
    assert (row.state, row.why) == (
        "ok", "mapped with poses 167 ms old; odom comes 700 ms after camera/depth of its stamp, "
        "and source.wait_s is 0.5",
    )  # fmt: skip
    assert missing_inputs(robot.synchronizer.inputs.rows()) == ""
    assert rows(driven(robot, 3))["odom"].why == ""
