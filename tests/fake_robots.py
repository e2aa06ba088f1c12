"""Robots with a fake body: they reach each target at once.

Session, presence, requests and missions are the service's own; so a fleet cannot tell them apart.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from types import SimpleNamespace

from edge.bus.presence import Presence
from edge.bus.requests import RequestServer
from edge.bus.session import zenoh_session
from edge.config import MissionConfig, ZenohConfig
from edge.errors import UserError
from edge.geometry import SE2
from edge.loop.input_log import InputLog
from edge.loop.mission_control import MissionControl
from edge.loop.requests.handlers import request_handlers
from edge.memory import Site
from edge.mission.run import MissionRun
from edge.mission.spec import MissionSpec, prepare

LIMITS = MissionConfig(time_limit_s=1e6)


def settings_of(port: int, name: str, **more: object) -> ZenohConfig:
    return ZenohConfig(endpoint=f"tcp/127.0.0.1:{port}", mode="client", prefix=f"robots/{name}",
                 shared_memory=False, **more)  # fmt: skip


class FakeService:
    """Stand-in for the parts of a service that `handle_mission` uses."""

    def __init__(self, known: Mapping[str, float], blind_to: frozenset[str]) -> None:
        self.blind_to = blind_to
        self.pose = SE2(0.0, 0.0, 0.0)
        self.goals = SimpleNamespace(client=SimpleNamespace(has_controller=True), phase="searching")
        idle = prepare(LIMITS, formula="F nothing")
        self.control = MissionControl(idle, LIMITS, self.goals, InputLog(), self.event)
        self.mission.set_idle()
        self.config = SimpleNamespace(
            mission=MissionConfig(), perception=SimpleNamespace(min_hits=1)
        )
        things = [
            SimpleNamespace(label=label, center_m=(away_m, 0.0, 0.0), hits=9, state="tentative")
            for label, away_m in known.items()
        ]
        self.map = SimpleNamespace(tracker=SimpleNamespace(all=things))
        self.site = SimpleNamespace(known=Site())
        self.detector_swap, self.perception = None, SimpleNamespace(scorers=None)
        self.behaviour = SimpleNamespace(task_status=lambda: None)
        self.events: list[str] = []
        self.begun = 0

    @property
    def mission(self) -> MissionRun:
        return self.control.mission

    @property
    def status(self):  # type: ignore[no-untyped-def]
        return self.mission.status(self.goals.phase)

    def begin(self, spec: MissionSpec, now_ns: int, id: str = "") -> None:
        if blind := self.blind_to & set(spec.targets):
            raise UserError(f"the detector knows no {min(blind)}")
        self.control.replace(self.control.make_run(spec, LIMITS, id), now_ns)
        self.mission.start(now_ns)
        self.begun += 1

    def event(self, text: str, now_ns: int) -> None:
        self.events.append(text)


class FakeRobot:
    """On the bus from its making until it is closed.

    Attributes:
        reaches_in_s: how long it takes for a target; None: until `reach`.
        problems: reasons why it is not ready.
    """

    def __init__(
        self,
        port: int,
        name: str,
        known: Mapping[str, float] | None = None,
        blind_to: frozenset[str] = frozenset(),
        reaches_in_s: float | None = None,
        announced: bool = True,
    ) -> None:
        self.name, self.reaches_in_s, self.problems = name, reaches_in_s, ()
        self.service = FakeService(known or {}, blind_to)
        self._stop = threading.Event()
        self._open = ExitStack()
        settings = settings_of(port, name)
        session = self._open.enter_context(zenoh_session(settings, "listen"))
        self.presence = Presence(session, settings)
        self._open.callback(self.presence.close)
        served = request_handlers(self.service, partial(prepare, LIMITS), lambda: self.problems)
        verbs, handle = served["mission/request"]
        key = settings.key("mission/request")
        self._server = RequestServer(session, key, verbs, handle)
        self._open.callback(self._server.close)
        if announced:
            self.presence.announce()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    @property
    def mission(self) -> MissionRun:
        return self.service.mission

    def reach(self) -> None:
        with self._lock:
            self.mission.on_reached("made up", time.monotonic_ns())

    def fail(self, reason: str) -> None:
        with self._lock:
            self.mission.finish("failed", reason, time.monotonic_ns())

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._open.close()

    def _loop(self) -> None:
        target, since_s = None, time.monotonic()
        while not self._stop.wait(0.01):
            now_ns = time.monotonic_ns()
            with self._lock:
                self._server.serve(now_ns)
                self.mission.observe(None, now_ns)
                if (at := (self.mission, self.mission.retargets)) != target:
                    target, since_s = at, time.monotonic()
                if self.reaches_in_s is None or self.mission.done or self.mission.paused:
                    continue
                if time.monotonic() - since_s >= self.reaches_in_s:
                    self.mission.on_reached("made up", now_ns)
