"""Requests of agents, such as language models: they read, and propose missions.

A proposal moves nothing. With `mcp.motion: ask`, a person decides on it by another key,
`confirm/request`, within `mcp.confirm_s`. Access rules can so give an agent `agent/request` alone.
`edge mcp` and the live page send these requests.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from edge.bus import topics
from edge.bus.verbs import Request, Verb, check_text
from edge.config import McpConfig
from edge.errors import UserError
from edge.loop.behaviours.room_targets import refuse_closed
from edge.loop.requests.handlers import check_repetition
from edge.loop.requests.intent_requests import carry_out
from edge.loop.requests.memory_requests import MEMORY_VERBS, handle_memory
from edge.mission.language.intents import MemoryQuestion
from edge.mission.spec import MissionSpec
from edge.text import one_line
from edge.types import CAMERAS

if TYPE_CHECKING:
    from edge.loop.service import Service

MAX_CHARS = 500
"""Longest instruction of an agent, in characters."""
MAX_WAITING = 3
"""Limit of proposals that wait for a person."""
_MAX_ENDED = 32
_MAX_NAME_CHARS = 40
_PREFIX = "agent."  # of the ids of missions that agents began
Pictures = Callable[[str], dict[str, Any]]
"""Returns the picture `map`, `camera` or `camera2` as JSON; called on a request's thread."""


@dataclass(eq=False)
class Proposal:
    """A mission, or a change of places, that an agent proposes.

    Attributes:
        id: random, and used once.
        text: the instruction, one line.
        by: name that the agent gives itself.
        prepared: what the instruction means.
        state: `started` after a person, or the configuration, allowed it.
    """

    id: str
    text: str
    by: str
    prepared: Any
    until_ns: int
    state: Literal["waiting", "started", "denied", "expired", "withdrawn"] = "waiting"

    @property
    def understood(self) -> str:
        """The effect, in words."""
        if isinstance(self.prepared, MissionSpec):
            return one_line(self.prepared.translation.understood)
        return one_line(f"{self.prepared.do}: {self.prepared.name}")


class AgentDesk:
    """The proposals of agents; for the loop's thread."""

    def __init__(self, service: Service, settings: McpConfig) -> None:
        self._service, self._settings = service, settings
        self._proposals: dict[str, Proposal] = {}

    def handle_agent(self, request: Request, now_ns: int) -> dict:
        """Handle a request of an agent.

        Raises:
            UserError: it is refused. Nothing has changed then.
        """
        service, fields = self._service, request.fields
        if request.do in MEMORY_VERBS:
            return handle_memory(service, request, now_ns)
        if request.do == "picture":
            picture: dict = request.prepared  # type: ignore[assignment]
            return picture
        if request.do == "propose":
            return self._propose(request, now_ns)
        if request.do == "cancel":
            return self._withdraw(fields["id"], now_ns)
        status, pose = service.status, service.pose
        return {
            "phase": status.phase,
            "reason": status.reason,
            "target": status.target,
            "instruction": status.instruction,
            "pose": None if pose is None else [pose.x_m, pose.y_m, pose.yaw_rad],
            "stopped": service.control.stopped,
            "motion": self._settings.motion,
            "proposals": [
                {"id": one.id, "text": one.text, "state": one.state}
                for one in self._current(now_ns).values()
            ],
        }

    def handle_confirm(self, request: Request, now_ns: int) -> dict:
        """List the waiting proposals, or decide on one.

        Raises:
            UserError: no such proposal waits, or it cannot be started.
        """
        if request.do != "list":
            proposal = self._current(now_ns).get(request.fields["id"])
            if proposal is None or proposal.state != "waiting":
                why = "unknown" if proposal is None else f"it is {proposal.state}"
                raise UserError(f"id: no proposal with this id waits: {why}")
            if request.do == "allow":
                self._start(proposal, now_ns)
            else:
                proposal.state = "denied"
            self._service.event(f"proposal of an agent {proposal.state}: {proposal.text}", now_ns)
        return {"proposals": self.waiting(now_ns)}

    def waiting(self, now_ns: int) -> list[dict[str, object]]:
        """Return the proposals that wait for a person, JSON-ready, oldest first."""
        return [
            {
                "id": one.id, "text": one.text, "understood": one.understood, "by": one.by,
                "left_s": round((one.until_ns - now_ns) * 1e-9, 1),
            }
            for one in self._current(now_ns).values() if one.state == "waiting"
        ]  # fmt: skip

    def _propose(self, request: Request, now_ns: int) -> dict:
        service, motion = self._service, self._settings.motion
        if isinstance(request.prepared, MemoryQuestion):
            return {"state": "answered", "text": carry_out(service, request.prepared, now_ns)}
        if motion == "refuse":
            raise UserError("mcp.motion is refuse: this robot takes no orders from agents")
        if len(self.waiting(now_ns)) >= MAX_WAITING:
            raise UserError(f"{MAX_WAITING} proposals already wait for a person; try again later")
        until_ns = now_ns + int(1e9 * self._settings.confirm_s)
        proposal = Proposal(
            secrets.token_hex(8), one_line(request.fields["instruction"], MAX_CHARS),
            request.fields["by"], request.prepared, until_ns,
        )  # fmt: skip
        if motion == "allow":
            if not (service.mission.done or service.mission.id.startswith(_PREFIX)):
                raise UserError("a mission of a person is running: an agent cannot replace it")
            self._start(proposal, now_ns)
        self._proposals[proposal.id] = proposal
        while len(self._proposals) > _MAX_ENDED:
            ended = next(one for one in self._proposals.values() if one.state != "waiting")
            del self._proposals[ended.id]
        verb = "asks for" if proposal.state == "waiting" else "began"
        service.event(f"an agent ({proposal.by}) {verb}: {proposal.text}", now_ns)
        return {
            "id": proposal.id, "state": proposal.state, "understood": proposal.understood,
            "confirm_within_s": self._settings.confirm_s if motion == "ask" else 0.0,
        }  # fmt: skip

    def _start(self, proposal: Proposal, now_ns: int) -> None:
        """Carry out a proposal; raise UserError if that is not possible."""
        service, prepared = self._service, proposal.prepared
        if isinstance(prepared, MissionSpec):
            refuse_closed(prepared, service.site.known, service.map)
            service.begin(prepared, now_ns, f"{_PREFIX}{proposal.id}")
        else:
            carry_out(service, prepared, now_ns)
        proposal.state = "started"

    def _withdraw(self, id: str, now_ns: int) -> dict:
        """Withdraw a proposal, or cancel the mission that it began."""
        proposal = self._current(now_ns).get(id)
        if proposal is None:
            raise UserError("id: no proposal has this id")
        if proposal.state == "waiting":
            proposal.state = "withdrawn"
        elif self._service.mission.id == f"{_PREFIX}{id}" and not self._service.mission.done:
            self._service.control.cancel("cancelled by the agent", now_ns)
        else:
            raise UserError(f"id: the proposal is {proposal.state}, and its mission does not run")
        return {"id": id, "state": proposal.state}

    def _current(self, now_ns: int) -> Mapping[str, Proposal]:
        """Return all proposals, after those that are too old have expired."""
        for one in self._proposals.values():
            if one.state == "waiting" and now_ns >= one.until_ns:
                one.state = "expired"
        return self._proposals


def _check_propose(fields: dict) -> dict:
    instruction = check_text("instruction", fields.get("instruction"), MAX_CHARS)
    by = one_line(check_text("by", fields.get("by", "agent"), MAX_CHARS), _MAX_NAME_CHARS)
    return {"instruction": instruction, "by": by, **check_repetition(fields)}


def _check_id(fields: dict) -> dict:
    return {"id": check_text("id", fields.get("id"), MAX_CHARS)}


def _check_picture(fields: dict) -> dict:
    if fields.get("of") not in ("map", *CAMERAS):
        raise ValueError(f"of: expected {', '.join(('map', *CAMERAS))}")
    return {"of": fields["of"]}


def agent_handlers(
    service: Service, settings: McpConfig, prepare: Callable[[dict], object], pictures: Pictures
) -> dict[str, tuple[Mapping[str, Verb], Callable[[Request, int], dict]]]:
    """Return verbs and handlers of the two keys; see `handlers.request_handlers`.

    Args:
        service: the running service. Its results list the waiting proposals from now on.
        settings: `mcp` of the configuration.
        prepare: prepares the fields of a new mission; called on a request's thread.
        pictures: see `Pictures`.
    """
    desk = AgentDesk(service, settings)
    service.publisher.proposals = desk.waiting

    def prepare_new(fields: dict) -> object:
        return prepare({name: fields[name] for name in ("instruction", "repeat") if name in fields})

    agent = {
        "status": Verb(read_only=True),
        "find": MEMORY_VERBS["find"],
        "rooms": MEMORY_VERBS["rooms"],
        "picture": Verb(("of",), _check_picture, lambda fields: pictures(fields["of"])),
        "propose": Verb(("instruction", "by", "rounds"), _check_propose, prepare_new),
        "cancel": Verb(("id",), _check_id),
    }
    decide = Verb(("id",), _check_id)
    confirm = {"list": Verb(read_only=True), "allow": decide, "deny": decide}
    return {
        topics.AGENT_REQUEST: (agent, desk.handle_agent),
        topics.CONFIRM_REQUEST: (confirm, desk.handle_confirm),
    }
