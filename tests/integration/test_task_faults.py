"""A task whose server answers late and falsely: it fails, and the next mission is driven."""

from __future__ import annotations

import threading
from collections.abc import Callable

from chat_server import saying, serving
from live_patience import PATIENCE_S, eventually
from simulated import simulated

from edge.lab.eval.closed_loop import ClosedLoop
from edge.tasks.mission_spec import prepare_mission

TASK = "Drive a little way."
BESIDE = {"loop": {"lockstep": False}, "sim": {"lockstep": True, "step_s": 0.2}}


def until(loop: ClosedLoop, what: Callable[[], object]) -> None:
    """Step until the condition holds."""
    eventually(lambda: what() or loop.step())


def test_a_late_false_answer_fails_only_its_task():
    gate = threading.Event()

    def late(handler):
        gate.wait()
        saying("no code")(handler)

    with serving(late) as server:
        planner = {"kind": "model", "url": server.url, "time_limit_s": PATIENCE_S,
                   "max_attempts": 1}  # fmt: skip
        loop = ClosedLoop(simulated({**BESIDE, "tasks": {"planner": planner}}), task=TASK)
        service = loop.service
        until(loop, lambda: server.requests)
        for _ in range(4):  # no tick waits for the server
            loop.step()
        assert not service.status.done
        gate.set()
        until(loop, lambda: service.status.done)
    assert service.status.phase == "failed"
    assert "no trajectory in 1 answers" in service.status.reason
    assert loop.drive.motion.path_m < 0.2
    service.begin(prepare_mission(loop.config, formula="F oven"), loop.drive.motion.stamp_ns)
    until(loop, lambda: loop.drive.motion.path_m > 0.5)
    loop.close()
