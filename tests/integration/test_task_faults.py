"""Tasks through faults: a server that stalls, gives false answers or sends 100 MB."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
from chat_server import saying, sends_100_mb, serving, stalls
from live_patience import PATIENCE_S, eventually
from simulated import simulated

from edge.lab.eval.closed_loop import ClosedLoop
from edge.tasks.mission_spec import prepare_mission

TASK = "Drive a little way."
BESIDE = {"loop": {"lockstep": False}, "sim": {"lockstep": True, "step_s": 0.2}}


def until(loop: ClosedLoop, what: Callable[[], object]) -> None:
    """Step until the condition holds."""
    eventually(lambda: what() or loop.step())


LEADS_AWAY = "```python\ngive_trajectory([line(robot()['position'], (1e9, float('nan')))])\n```"


@pytest.mark.parametrize(
    ("behave", "said"),
    [
        (stalls, "no complete answer within 1 s"),
        (sends_100_mb, "the answer has more than 256 KB"),
        (saying(LEADS_AWAY), "no trajectory in 2 answers"),
    ],
    ids=["stalls", "100 MB", "lies"],
)
def test_a_misbehaving_server_fails_only_its_task(behave, said):
    limit_s, answers = (1.0 if behave is stalls else PATIENCE_S), threading.Event()

    def held(handler):
        answers.wait()
        behave(handler)

    with serving(stalls if behave is stalls else held) as server:
        planner = {"kind": "model", "url": server.url, "time_limit_s": limit_s, "max_attempts": 2}
        loop = ClosedLoop(simulated({**BESIDE, "tasks": {"planner": planner}}), task=TASK)
        service = loop.service
        until(loop, lambda: server.requests)
        for _ in range(4):  # no tick waits for the server
            loop.step()
        waits = not service.status.done
        answers.set()
        until(loop, lambda: service.status.done)
    assert (service.status.phase, "\n" in service.status.reason) == ("failed", False)
    assert said in service.status.reason
    assert loop.drive.motion.path_m < 0.2
    assert waits or behave is stalls, "the loop waited for the server"
    service.begin(prepare_mission(loop.config, formula="F oven"), loop.drive.motion.stamp_ns)
    until(loop, lambda: loop.drive.motion.path_m > 0.5)
    loop.close()
