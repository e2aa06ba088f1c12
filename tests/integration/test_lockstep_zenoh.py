"""A run in lockstep over Zenoh is the same each time, whatever holds up its processes."""

from __future__ import annotations

import random
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import psutil
import pytest
from simulated import simulated

from edge.config import Config
from edge.launch import child_processes, open_service, with_free_port
from edge.loop.result import TickResult
from edge.loop.runner import loop

SEARCH = {
    "mission": {"target": "sofa", "time_limit_s": 60.0},
    "loop": {"lockstep": True},
    "sim": {"lockstep": True},
}


@contextmanager
def held_up() -> Iterator[list[str]]:
    """Suspend a random child for longer than the resend interval."""
    over, held = threading.Event(), []

    def hold() -> None:
        luck = random.Random(0)
        while not over.wait(luck.uniform(0.2, 0.6)):
            children = [child for child in psutil.Process().children() if is_edge(child)]
            if children:
                child = luck.choice(children)
                with suppress(psutil.NoSuchProcess):  # it ended meanwhile
                    child.send_signal(signal.SIGSTOP)
                    over.wait(luck.uniform(0.6, 1.2))
                    child.send_signal(signal.SIGCONT)
                    held.append(str(child.pid))

    thread = threading.Thread(target=hold)
    thread.start()
    try:
        yield held
    finally:
        over.set()
        thread.join()


def is_edge(process: psutil.Process) -> bool:
    with suppress(psutil.NoSuchProcess):  # as of one that ended
        return any("edge.cli" in word for word in process.cmdline())
    return False


class Course:
    """Sink that keeps each observation's pose and boxes, the goals, and the status."""

    def __init__(self) -> None:
        self.ticks: list[tuple] = []
        self.phase = ""

    def tick(self, result: TickResult) -> None:
        self.phase = result.status.phase
        seen, found = result.observation, result.detections
        if seen is not None:
            boxes = None if found is None else found.xyxy_px.tolist()
            goals = [(goal.stamp_ns, goal.kind, goal.pose) for goal in result.goals]
            pose = seen.T_map_base.tolist()
            self.ticks.append((seen.stamp_ns, pose, boxes, goals, result.status))

    def close(self) -> None:
        pass


def drive(config: Config) -> Course:
    """Run service, simulator and controller as processes, until the mission has ended."""
    config, over, course = with_free_port(config), threading.Event(), Course()
    with (
        open_service(config, [course], stop=over) as running,
        child_processes(config, over, ("sim", "--no-motion"), ("sim", "--motion-only")),
    ):
        loop(running, over, once=True)
    return course


@pytest.mark.slow
def test_a_run_is_the_same_with_delayed_processes():
    first = drive(simulated(SEARCH))
    with held_up() as held:
        second = drive(simulated(SEARCH))
    assert len(held) > 2
    assert len(first.ticks) > 50
    assert first.ticks == second.ticks
    assert first.phase == second.phase == "reached"


@pytest.mark.parametrize("mapped", ["depth", "cloud"])
def test_a_run_with_two_cameras(mapped):
    second = {"width_px": 160, "height_px": 128, "yaw_deg": 180.0}
    lidar = {"z_m": 0.4, "pitch_deg": 15.0} if mapped == "cloud" else None
    config = simulated({
        **SEARCH, "mapping": {"input": mapped},
        "sensors": {"second_camera": second, "lidar": lidar},
    })  # fmt: skip
    course = drive(config)
    assert course.phase == "reached"
    assert any(boxes for _, _, boxes, _, _ in course.ticks)
