"""List of the online robots of a fleet, with the status that each robot reports.

A robot's name is the last word of its `zenoh.prefix`. Robots whose prefixes differ only in this
word are a fleet.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import zenoh
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from edge.bus import client, presence, topics
from edge.bus.session import BusError
from edge.config import ZenohConfig
from edge.errors import UserError
from edge.text import one_line
from edge.types import MissionPhase

ANSWER_S = 2.0
"""Time in seconds in which a robot must answer."""
OVER = ("idle", "reached", "failed")
"""Phases of a mission that no longer runs."""
_MAX_PARALLEL = 32  # requests
_RETRY_S = 0.05  # before the list of robots is requested again
_FINITE = ConfigDict(allow_inf_nan=False)  # a reply with NaN or infinity is invalid


@dataclass(frozen=True)
class PastMission:
    """Result of a finished mission that had an id; for the fields see `StatusReply`."""

    id: str
    phase: Literal["reached", "failed"]
    reason: str


@dataclass(frozen=True)
class RobotState:
    """State of a robot, apart from its mission.

    Attributes:
        pose: x and y in metres, yaw in radians, in the robot's own `map`; None before the first.
        controller: `answers`: the motion controller answers; `silent`: it does not.
        problems: Reasons why the robot is not ready; empty if the robot is ready.
        known: Metres to the nearest object of each label in its map.
    """

    __pydantic_config__ = _FINITE

    pose: tuple[float, float, float] | None
    controller: Literal["answers", "silent"]
    problems: tuple[str, ...]
    known: dict[str, Annotated[float, Field(ge=0)]]


@dataclass(frozen=True)
class StatusReply:
    """The fields of a service's reply to `status` that a fleet uses.

    Attributes:
        instruction: Text of the mission.
        target: Active target, if any.
        elapsed_s: Duration of the mission so far, in seconds.
        past: Results of earlier missions, oldest first.
    """

    __pydantic_config__ = _FINITE

    id: str
    instruction: str
    phase: MissionPhase
    reason: str
    target: str | None
    elapsed_s: float
    past: tuple[PastMission, ...]
    robot: RobotState


_STATUS_REPLY = TypeAdapter(StatusReply)


@dataclass(frozen=True)
class Robot:
    """An online robot.

    Attributes:
        name: Last word of the robot's prefix.
        status_reply: The robot's status; None if there is no valid reply.
        problem: Reason why there is no valid reply; "" if the reply is valid.
    """

    name: str
    status_reply: StatusReply | None = None
    problem: str = ""
    reply: Mapping[str, Any] | None = None

    @property
    def busy_with(self) -> str:
        """Reason why the robot cannot take a mission now; "" if the robot is free."""
        if (reply := self.status_reply) is None:
            return self.problem
        if reply.phase not in OVER:
            return f"{reply.phase}: {one_line(reply.instruction, 80)}"
        if reply.robot.problems:
            return one_line("; ".join(reply.robot.problems))
        return "its controller is silent" if reply.robot.controller == "silent" else ""


class Roster:
    """The robots of a fleet that are online in one Zenoh session.

    Args:
        settings: Zenoh settings of any robot of the fleet, or of the client. Endpoint,
            `client_file` and `topics` are used, and the prefix without its last word.

    Attributes:
        pattern: Zenoh key expression of the prefixes of the fleet, such as `site/*`.
    """

    def __init__(self, session: zenoh.Session, settings: ZenohConfig) -> None:
        parent = settings.prefix.rpartition("/")[0]
        self.pattern = f"{parent}/*" if parent else "*"
        self._session, self._settings = session, settings
        self._changed = threading.Event()
        self._last_prefixes: Set[str] = set()  # prefixes in the last list of online robots
        self._pool = ThreadPoolExecutor(_MAX_PARALLEL, thread_name_prefix="robot")
        self._subscriber = session.liveliness().declare_subscriber(
            f"{self.pattern}/{topics.ALIVE}/*", lambda sample: self._changed.set()
        )

    @property
    def online(self) -> bool:
        """True if the session is connected to a router or to a service."""
        info = self._session.info
        return bool([*info.routers_zid(), *info.peers_zid()])

    def names(self) -> list[str]:
        """Return the names of the online robots, sorted."""
        return sorted(self._sessions())

    def ask_status(self) -> dict[str, Robot]:
        """Ask every online robot for its status; return the robots by name.

        The call takes as long as the slowest robot, at most `ANSWER_S`.

        Raises:
            BusError: The router did not list the robots.
        """
        online = self._sessions()
        robots = self.ask(online, {"do": "status"}, ANSWER_S)
        for name, sessions in online.items():
            if len(sessions) > 1:
                problem = f"{len(sessions)} services use this name: stop all but one"
                robots[name] = replace(robots[name], status_reply=None, problem=problem)
        return robots

    def complete_list(self) -> dict[str, Robot] | None:
        """Return the same as `ask_status`, or None if the list may lack robots that are online."""
        if not self.online:
            return None
        try:
            robots = self.ask_status()
        except BusError:
            return None
        return robots if self.online else None

    def ask(
        self, names: Iterable[str], request: Mapping[str, Any], timeout_s: float
    ) -> dict[str, Robot]:
        """Send the same request to each robot; return the robots with their replies, in order."""
        return dict(self._pool.map(lambda name: (name, self._ask(name, request, timeout_s)), names))

    def run_all(self, calls: Iterable[Callable[[], None]]) -> None:
        """Run the calls in parallel and wait for all."""
        for done in [self._pool.submit(call) for call in calls]:
            done.result()

    def send(self, name: str, request: Mapping[str, Any], timeout_s: float) -> dict:
        """Send a request to one robot and return its reply.

        Raises:
            RequestError: See `edge.bus.client.send_request`.
        """
        key = settings_of_robot(self._settings, name).key(topics.MISSION_REQUEST)
        return client.send_request(self._session, key, dict(request), timeout_s, one_line(name))

    def wait(self, seconds: float) -> None:
        """Wait for this time, or until a robot comes online or goes offline."""
        self._changed.wait(seconds)
        self._changed.clear()

    def close(self) -> None:
        """Stop watching the robots; requests that have not begun are dropped."""
        self._subscriber.undeclare()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _sessions(self) -> dict[str, set[str]]:
        """Return the ids of the Zenoh sessions of each online robot, by name."""
        found = presence.online_sessions(self._session, self.pattern)
        if self._last_prefixes - found.keys():
            # The list sometimes lacks a robot that is online, while another one comes or goes.
            time.sleep(_RETRY_S)
            found = presence.online_sessions(self._session, self.pattern) | found
        self._last_prefixes = found.keys()
        return {prefix.rpartition("/")[2]: found[prefix] for prefix in sorted(found)}

    def _ask(self, name: str, request: Mapping[str, Any], timeout_s: float) -> Robot:
        """Return a robot with its reply to a request, or with the reason why there is none."""
        try:
            answer = self.send(name, request, timeout_s)
        except UserError as error:
            # An error is "NAME: reason".
            return Robot(name, problem=str(error).partition(": ")[2])
        try:
            return Robot(name, _STATUS_REPLY.validate_python(answer), reply=answer)
        except ValidationError as error:
            fault = error.errors(include_input=False, include_url=False)[0]
            where = ".".join(map(str, fault["loc"]))
            return Robot(name, problem=one_line(f"invalid status reply: {where}: {fault['msg']}"))


def settings_of_robot(settings: ZenohConfig, name: str) -> ZenohConfig:
    """Return the settings for the robot with this name, the last word of its prefix."""
    parent = settings.prefix.rpartition("/")[0]
    return settings.model_copy(update={"prefix": f"{parent}/{name}" if parent else name})


@contextmanager
def open_roster(settings: ZenohConfig) -> Iterator[Roster]:
    """Open a roster with its own session.

    Raises:
        RequestError: Nothing listens at the endpoint, or it refuses the connection.
    """
    with client.connect(
        settings, client.CONNECT_S, "fleet", "router", "edge fleet router"
    ) as session:
        roster = Roster(session, settings)
        try:
            yield roster
        finally:
            roster.close()
