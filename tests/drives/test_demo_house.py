"""The ready demo in simulated time: real inference of the shipped model in the loop."""

from __future__ import annotations

import pytest

from edge.config import Config, load
from edge.lab.eval.closed_loop import ClosedLoop

KITCHEN = [6.6, 1.4, 1.2]


def demo(target: str, start: list[float] | None = None) -> Config:
    """Return the demo's configuration in lockstep, at 10 images a second."""
    config = load("demo", {})
    return config.model_copy(
        update={
            "loop": config.loop.model_copy(update={"lockstep": True}),
            "mission": config.mission.model_copy(update={"target": target}),
            "sim": config.sim.model_copy(
                update={"lockstep": True, "step_s": 0.1, "start": start and tuple(start)}
            ),
        }
    )


def run(target: str, start: list[float] | None = None, seconds: float = 200) -> ClosedLoop:
    loop = ClosedLoop(demo(target, start)).run(seconds)
    assert loop.service.status.phase == "reached", (loop.service.status, loop.notes.events)
    assert loop.drive.motion.collisions == 0
    return loop


def trash_can_m(loop: ClosedLoop, tall: bool) -> float:
    """Return the robot's distances from the kitchen's tall white trash can and any other one."""
    pose = loop.drive.motion.pose
    return min(
        obj.distance_m(pose.x_m, pose.y_m)
        for obj in loop.world.objects
        if obj.label == "trash can" and (obj.size_m[2] > 0.8) == tall
    )


@pytest.mark.parametrize(
    ("phrase", "tall"),
    [("tall white trash can", True), ("white bin", True), ("green trash can", False)],
)
def test_the_robot_drives_to_the_described_one_of_two_objects(phrase, tall):
    loop = run(phrase, KITCHEN, 60)
    assert trash_can_m(loop, tall) <= 1.0
    assert trash_can_m(loop, tall) < trash_can_m(loop, not tall)


@pytest.mark.slow
def test_the_robot_finds_a_described_object_from_afar():
    loop = run("tall white trash can")
    assert trash_can_m(loop, True) <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("target", ["refrigerator", "wardrobe", "backpack"])
def test_the_demo_reaches_its_target(target):
    assert run(target).distance_m(target) <= 1.0
