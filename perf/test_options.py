"""Benchmark: the cost that each option adds to a tick, on the loop's thread.

A figure is a mean over ticks, because most of this work is due a few times a second.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from edge.bus.requests import RequestServer
from edge.bus.session import open_session
from edge.config import Config, parse
from edge.host.ports import free_port
from edge.host.stop_latch import StopLatch
from edge.lab.eval.closed_loop import ClosedLoop
from edge.live.agent_view import AgentView
from edge.live.sink import LiveSink
from edge.loop.requests.agent_requests import agent_handlers
from edge.loop.result import TickResult
from edge.sinks.rerun import RerunSink
from edge.sinks.ros2 import Ros2Sink

TICKS = 150
Work = Callable[[TickResult], object]


def stop_latch(loop: ClosedLoop, stack: ExitStack, folder: Path) -> Work:
    """Confirm the stop state in the latch, as `edge.loop.runner` does."""
    latch = StopLatch(folder / "stop.json")

    def work(_: TickResult) -> None:
        assert latch.reason == loop.service.control.stopped
        latch.confirm(loop.service.control.stopped)

    return work


def agents(loop: ClosedLoop, stack: ExitStack, folder: Path) -> Work:
    """Serve the requests of agents, of which none come, with a picture asked for all the time."""
    session = stack.enter_context(open_session(loop.config.zenoh, "listen"))
    now_s = [0.0]  # simulated: on a slow computer, an agent asks no more of a tick
    view = AgentView(lambda: now_s[0])
    handlers = agent_handlers(loop.service, loop.config.mcp, dict, view.picture)
    servers = [RequestServer(session, f"edge/{key}", *of) for key, of in handlers.items()]
    for server in servers:
        stack.callback(server.close)

    def work(result: TickResult) -> None:
        for server in servers:
            server.serve(result.now_ns)
        now_s[0] = 1e-9 * result.now_ns
        view.mark_watched()
        view.tick(result)

    return work


def viewer(loop: ClosedLoop, stack: ExitStack, folder: Path) -> Work:
    """Collect the state for an open live page."""
    now_s = [0.0]
    sink = LiveSink(lambda: now_s[0])

    def work(result: TickResult) -> None:
        now_s[0] = 1e-9 * result.now_ns
        sink.mark_watched()
        sink.tick(result)

    return work


def rerun(loop: ClosedLoop, stack: ExitStack, folder: Path) -> Work:
    """Write a file for the Rerun viewer."""
    pytest.importorskip("rerun", reason="pip install 'edge-vln[rerun]'")
    sink = RerunSink(loop.config, str(folder / "edge.rrd"))
    stack.callback(sink.close)
    return sink.tick


def ros2(loop: ClosedLoop, stack: ExitStack, folder: Path, **settings: object) -> Work:
    """Publish to a ROS 2 graph; `settings` are those of `ros2`."""
    session = stack.enter_context(open_session(loop.config.zenoh, "listen"))
    of = loop.config.ros2.model_copy(update={"via": "bridge", "goals": "topic", **settings})
    sink = Ros2Sink(loop.config.model_copy(update={"ros2": of}), session)
    stack.callback(sink.close)
    return sink.tick


def vision_msgs(loop: ClosedLoop, stack: ExitStack, folder: Path) -> Work:
    """Send detections and objects as the sink `ros2` does."""
    return ros2(loop, stack, folder, detections_frame="camera")


OPTIONS = {make.__name__: make for make in (stop_latch, agents, viewer, rerun, ros2, vision_msgs)}


@pytest.fixture
def config() -> Config:
    return parse({
        "perception": {"detector": {"kind": "sim"}}, "mission": {"target": "toilet"}, "mcp": {},
        "loop": {"lockstep": True}, "sim": {"lockstep": True, "step_s": 1 / 30},
        "zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
    })  # fmt: skip


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.mark.parametrize("option", OPTIONS)
def test_an_option_and_its_tick(benchmark, option, config, stack, tmp_path):
    """Compare with the tick itself, on the same drive; the detector's time is in neither."""
    loop = ClosedLoop(config)
    work = OPTIONS[option](loop, stack, tmp_path)
    clock, spent_s, took_s = time.thread_time, [0.0], []
    detect = loop.worker.submit

    def submit(observation) -> None:
        began_s = clock()
        detect(observation)
        spent_s[0] += clock() - began_s

    loop.worker.submit = submit

    def drive() -> tuple[tuple, dict]:
        loop.step()
        observation, now_ns = loop.observe(), loop.drive.motion.stamp_ns
        spent_s[0], began_s = 0.0, clock()
        loop.service.tick(observation, now_ns)
        took_s.append(clock() - began_s - spent_s[0])
        return (loop.service.result(now_ns, observation),), {}

    benchmark.extra_info["budget"] = f"tick_{option}"
    benchmark.pedantic(work, setup=drive, rounds=TICKS, warmup_rounds=30)
    benchmark.extra_info["reference_ms"] = 1e3 * statistics.mean(took_s[30:])
