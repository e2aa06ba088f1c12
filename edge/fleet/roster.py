"""Who is there, and how each robot stands by its own account.

A robot's name is the last word of its `zenoh.prefix`; those whose prefixes are alike but for it are
a fleet.
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
from edge.config import Zenoh
from edge.errors import UserError
from edge.text import one_line
from edge.types import MissionPhase

ANSWER_S = 2.0
OVER = ("idle", "reached", "failed")
_ASKED_AT_ONCE = 32
_AGAIN_S = 0.05
_FINITE = ConfigDict(allow_inf_nan=False)


@dataclass(frozen=True)
class Past:
    """What became of a mission that had a name."""

    id: str
    phase: Literal["reached", "failed"]
    reason: str


@dataclass(frozen=True)
class Body:
    """A robot as such.

    Attributes:
        pose: x and y in metres, yaw in radians, in its own `map`; None before there was any.
        amiss: why nobody can count on it.
        known: metres to the nearest thing of each label that is in its map.
    """

    __pydantic_config__ = _FINITE

    pose: tuple[float, float, float] | None
    controller: Literal["answers", "silent"]
    amiss: tuple[str, ...]
    known: dict[str, Annotated[float, Field(ge=0)]]


@dataclass(frozen=True)
class Account:
    """What a service answers to `status`, as far as a fleet goes by it."""

    __pydantic_config__ = _FINITE

    id: str
    instruction: str
    phase: MissionPhase
    reason: str
    target: str | None
    elapsed_s: float
    past: tuple[Past, ...]
    robot: Body


_ACCOUNT = TypeAdapter(Account)


@dataclass(frozen=True)
class Robot:
    """One that is there.

    Attributes:
        account: None where it gave none that makes sense; `problem` says why.
        answer: the same as it came.
    """

    name: str
    account: Account | None = None
    problem: str = ""
    answer: Mapping[str, Any] | None = None

    @property
    def busy_with(self) -> str:
        """Why it cannot be given a mission now; "" where it can."""
        if (account := self.account) is None:
            return self.problem
        if account.phase not in OVER:
            return f"{account.phase}: {one_line(account.instruction, 80)}"
        if account.robot.amiss:
            return one_line("; ".join(account.robot.amiss))
        return "its controller is silent" if account.robot.controller == "silent" else ""


class Roster:
    """A fleet as it is seen from one session.

    Args:
        settings: of one robot, or of whoever looks: endpoint, `client_file` and `topics` count, and
            all of the prefix but its last word.
    """

    def __init__(self, session: zenoh.Session, settings: Zenoh) -> None:
        parent = settings.prefix.rpartition("/")[0]
        self.pattern = f"{parent}/*" if parent else "*"
        self._session, self._settings = session, settings
        self._changed = threading.Event()
        self._before: Set[str] = set()
        self._pool = ThreadPoolExecutor(_ASKED_AT_ONCE, thread_name_prefix="robot")
        self._heard = session.liveliness().declare_subscriber(
            f"{self.pattern}/{topics.ALIVE}/*", lambda sample: self._changed.set()
        )

    @property
    def online(self) -> bool:
        """Whether there is a router, or a service in its place, to look through."""
        info = self._session.info
        return bool([*info.routers_zid(), *info.peers_zid()])

    def names(self) -> list[str]:
        return sorted(self._sessions())

    def look(self) -> dict[str, Robot]:
        """Every robot that is there, by name; takes as long as the slowest, `ANSWER_S` at most.

        Raises:
            BusError: the router did not say who is.
        """
        there = self._sessions()
        robots = self.ask(there, {"do": "status"}, ANSWER_S)
        for name, sessions in there.items():
            if len(sessions) > 1:
                problem = f"{len(sessions)} services have this name: stop all but one"
                robots[name] = replace(robots[name], account=None, problem=problem)
        return robots

    def seen(self) -> dict[str, Robot] | None:
        """The same; None where not all can be seen: whoever is missing then need not be gone."""
        if not self.online:
            return None
        try:
            robots = self.look()
        except BusError:
            return None
        return robots if self.online else None

    def ask(
        self, names: Iterable[str], request: Mapping[str, Any], timeout_s: float
    ) -> dict[str, Robot]:
        """What each answers to the same request, in the names' order."""
        return dict(self._pool.map(lambda name: (name, self._ask(name, request, timeout_s)), names))

    def each(self, calls: Iterable[Callable[[], None]]) -> None:
        """Do these at the same time."""
        for done in [self._pool.submit(call) for call in calls]:
            done.result()

    def tell(self, name: str, request: Mapping[str, Any], timeout_s: float) -> dict:
        """One robot's answer.

        Raises:
            RequestError: see `edge.bus.client.ask`.
        """
        key = replaced_last(self._settings, name).key(topics.MISSION_REQUEST)
        return client.ask(self._session, key, dict(request), timeout_s, one_line(name))

    def wait(self, seconds: float) -> None:
        """Until then, or until somebody comes or goes."""
        self._changed.wait(seconds)
        self._changed.clear()

    def close(self) -> None:
        self._heard.undeclare()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _sessions(self) -> dict[str, set[str]]:
        found = presence.prefixes(self._session, self.pattern)
        if self._before - found.keys():
            # An answer now and then lacks one that is there, just as another comes or goes.
            time.sleep(_AGAIN_S)
            found = presence.prefixes(self._session, self.pattern) | found
        self._before = found.keys()
        return {prefix.rpartition("/")[2]: found[prefix] for prefix in sorted(found)}

    def _ask(self, name: str, request: Mapping[str, Any], timeout_s: float) -> Robot:
        try:
            answer = self.tell(name, request, timeout_s)
        except UserError as error:
            return Robot(name, problem=str(error).partition(": ")[2])
        try:
            return Robot(name, _ACCOUNT.validate_python(answer), answer=answer)
        except ValidationError as error:
            fault = error.errors(include_input=False, include_url=False)[0]
            where = ".".join(map(str, fault["loc"]))
            return Robot(name, problem=one_line(f"not a service's answer: {where}: {fault['msg']}"))


def replaced_last(settings: Zenoh, name: str) -> Zenoh:
    """The settings of another robot of the fleet; its name is what a token said."""
    parent = settings.prefix.rpartition("/")[0]
    return settings.model_copy(update={"prefix": f"{parent}/{name}" if parent else name})


@contextmanager
def open_roster(settings: Zenoh, patience_s: float = client.CONNECT_S) -> Iterator[Roster]:
    """A roster with a session of its own.

    Raises:
        RequestError: nobody is at the endpoint, or takes us in.
    """
    with client.connect(settings, patience_s, "fleet", "router", "edge fleet router") as session:
        roster = Roster(session, settings)
        try:
            yield roster
        finally:
            roster.close()
