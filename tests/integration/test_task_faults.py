"""Tasks through faults: a server that stalls, lies, sends 100 MB or dies; a detector swapped."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable

import pytest
from chat_server import saying, send, sends_100_mb, serving, stalls
from live_patience import PATIENCE_S, eventually
from simulated import simulated

from edge.host import resources
from edge.lab.eval.closed_loop import ClosedLoop
from edge.tasks.mission_spec import prepare_mission

TASK = "Drive a little way."
SHIPPED = "mini-house-256x320-int8-cpu"
BESIDE = {"loop": {"lockstep": False}, "sim": {"lockstep": True, "step_s": 0.2}}


def until(loop: ClosedLoop, what: Callable[[], object]) -> int:
    """Step until the condition holds."""
    deadline_s, steps = time.monotonic() + PATIENCE_S, 0
    while not what():
        assert time.monotonic() < deadline_s, loop.notes.events
        loop.step()
        steps += 1
    return steps


def swapped_to(state: str, loop: ClosedLoop) -> bool:
    """Return True if the swap has reached this state, after its next step."""
    swapper = loop.service.detector_swap
    swapper.step(loop.drive.motion.stamp_ns)
    assert swapper.state not in ("refused", "rolled back"), swapper.status()
    return swapper.state == state


def dies(handler):
    handler.send_response(200)
    handler.send_header("Content-Length", "1000")
    handler.end_headers()
    handler.wfile.write(b'{"choices": [{')
    handler.connection.close()


LEADS_AWAY = "```python\ngive_trajectory([line(robot()['position'], (1e9, float('nan')))])\n```"


@pytest.mark.parametrize(
    ("behave", "said"),
    [
        (stalls, "no complete answer within 1 s"),
        (sends_100_mb, "the answer has more than 256 KB"),
        (dies, "closed the connection before its answer was complete"),
        (lambda h: send(h, b"<html>welcome</html>"), "the answer is not JSON"),
        (saying(LEADS_AWAY), "no trajectory in 2 answers"),
    ],
    ids=["stalls", "100 MB", "dies", "no JSON", "lies"],
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


def test_a_detector_is_swapped_while_a_task_is_driven(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir(parents=True)
    shipped = resources.data_dir("models") / SHIPPED
    card = shipped.with_name(f"{SHIPPED}.yaml").read_text(encoding="utf-8")
    (resources.models_dir() / "other.yaml").write_text(
        card.replace(f"name: {SHIPPED}", "name: other"), encoding="utf-8"
    )
    shutil.copy(f"{shipped}.onnx", resources.models_dir())
    perception = {
        "detector": {"kind": "onnx", "model": SHIPPED, "threads": 1},
        "swap": {"probation": 10, "budget_ms": 1e5},
    }
    lockstep = {"lockstep": True, "step_s": 0.2}
    config = simulated({"loop": {"lockstep": True}, "sim": lockstep, "perception": perception})
    loop = ClosedLoop(config, task="go to the sofa")
    service = loop.service
    until(loop, lambda: service.behaviour.facts().phase == "driving")
    service.detector_swap.request("other", False, loop.drive.motion.stamp_ns)
    for _ in range(5):  # the images that the model is tried on
        loop.step()
    # Loading takes as long as the computer is busy, and the simulation would drive on to the end.
    eventually(lambda: swapped_to("on probation", loop))
    until(loop, lambda: swapped_to("kept", loop) and service.status.done)
    assert service.status.phase == "reached", loop.notes.events
    assert (service.detector_swap.running, service.detector_swap.outcomes["kept"]) == ("other", 1)
    assert loop.distance_m("sofa") <= 1.0
    assert loop.drive.motion.collisions == 0
    service.detector_swap.close()
    loop.close()
