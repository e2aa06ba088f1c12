"""A simulated robot in a house, the real loop around its service, and the page's server."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

from simulated import simulated

from edge.bus.request_queue import RequestQueue
from edge.bus.stop import stop_requests
from edge.geometry import SE2
from edge.host.credentials import BearerToken
from edge.host.service_manager import SystemdNotifier
from edge.host.web_server import serve
from edge.lab.eval.closed_loop import ClosedLoop
from edge.live.sink import LiveSink
from edge.live.view import PUBLIC, LiveView
from edge.loop.monitoring.service_health import PROBES, ServiceHealth
from edge.loop.requests.agent_requests import agent_handlers
from edge.loop.requests.handlers import mission_verbs, request_handlers
from edge.loop.result import TickResult
from edge.loop.runner import RunningService, loop
from edge.memory import KnownObject
from edge.tasks.facts import TaskStatus
from edge.tasks.mission_spec import prepare_mission
from edge.types import GoalStatus, Observation

TOKEN = "a-token-of-the-tests"
HERE = "127.0.0.1"


class Robot:
    """The service's source: each look drives the robot on, at the pace of the simulation."""

    def __init__(self, closed: ClosedLoop) -> None:
        self.counters = Counter(received=0, observations=0)
        self.epoch = 0
        self.inbox = SimpleNamespace(poll=self._said, overruns=0)
        self.blind = False
        self._closed, self._told, self._answers = closed, 0, list[GoalStatus]()
        self._due_s = self._map_due_s = 0.0
        closed.drive.motion = replace(closed.drive.motion, stamp_ns=time.time_ns())

    @property
    def pose(self) -> SE2:
        return self._closed.drive.motion.odometry

    def poll(self) -> Observation | None:
        now_s = time.monotonic()
        if self.blind or now_s < self._due_s:
            return None
        self._due_s = now_s + self._closed.config.sim.step_s
        self._drive()
        return self._closed.observe()

    def _drive(self) -> None:
        closed, motion = self._closed, self._closed.drive.motion
        if time.monotonic() > self._map_due_s:
            self._map_due_s = time.monotonic() + 0.5
            closed.controller.on_map(closed.service.map.grid.snapshot())
        goals = closed.notes.goals
        for goal in goals[self._told :]:
            self._answers += closed.controller.on_goal(goal.stamp_ns, goal.pose)
        self._told = len(goals)
        command, more = closed.controller.step(
            motion.odometry, motion.v_mps, motion.w_radps, motion.stamp_ns
        )
        self._answers += more
        closed.drive.step(closed.config.sim.step_s, command.v_mps, command.w_radps)

    def _said(self) -> list[GoalStatus]:
        said, self._answers = self._answers, []
        return said


class Brittle:
    """A sink that raises while it is `broken`."""

    broken = False

    def tick(self, result: TickResult) -> None:
        if self.broken:
            raise ValueError("<b>broken</b>")

    def close(self) -> None: ...


class Tasked:
    """Hands results on to the page as if a task were under way, or other objects known."""

    task: TaskStatus | None = None
    objects: list[KnownObject] | None = None

    def __init__(self, page: LiveSink) -> None:
        self._page, self.close = page, page.close

    def tick(self, result: TickResult) -> None:
        if self.task:
            result = replace(result, task=lambda: self.task)
        if self.objects:
            result = replace(result, objects=lambda: self.objects)
        self._page.tick(result)


class House:
    """House behind a live page.

    Attributes:
        url: of the page.
        view, service, robot, brittle, tasked: parts that a test can change.
    """

    def __init__(
        self, port: int, view: LiveView, closed: ClosedLoop, brittle: Brittle, tasked: Tasked
    ) -> None:
        self.url = f"http://{HERE}:{port}/"
        self.port, self.view, self.closed, self.brittle = port, view, closed, brittle
        self.service, self.robot, self.tasked = closed.service, Robot(closed), tasked


@contextmanager
def open_house(token: str | None = TOKEN, **sections: dict) -> Iterator[House]:
    """Run a service until the block ends."""
    http = {} if token is None else {"http": {"token_file": "/none"}}
    config = simulated({"loop": {"hz": 50.0}, "mission": {"target": "bed"}, **http, **sections})
    vitals = ServiceHealth(SystemdNotifier({}))
    view, brittle = LiveView(config, vitals), Brittle()
    tasked = Tasked(view.sink)
    closed = ClosedLoop(config, sinks=(tasked, brittle))
    if config.mission.on_request:
        closed.service.mission.set_idle()
    prepare = partial(prepare_mission, config)
    handlers = request_handlers(closed.service, prepare)
    if config.mcp is not None:
        prepare_new = mission_verbs(prepare)["new"].prepare
        handlers |= agent_handlers(closed.service, config.mcp, prepare_new, lambda of: {})
    queues = {key: RequestQueue(key, verbs, handle) for key, (verbs, handle) in handlers.items()}
    known = None if token is None else BearerToken(token.encode())
    pages, stop = {**vitals.pages(), **view.pages()}, threading.Event()
    with serve(pages, HERE, 0, known, PROBES, view.forms(), PUBLIC) as port:
        house = House(port, view, closed, brittle, tasked)
        running = RunningService(
            config=config, service=closed.service, worker=closed.worker, source=house.robot,
            servers=queues,
        )  # fmt: skip
        thread = threading.Thread(
            target=loop, args=(running, stop), kwargs={"each": partial(vitals.beat, running)}
        )
        vitals.ready()
        thread.start()
        view.open({**queues, **stop_requests(running.latch)})
        try:
            yield house
        finally:
            stop.set()
            thread.join()
            for queue in queues.values():
                queue.close()
            closed.close()
