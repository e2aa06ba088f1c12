"""What the loop does with an order from outside: a new mission, pause, resume, cancel, status."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edge.bus.desk import Request
from edge.errors import UserError
from edge.loop.result import facts_of
from edge.loop.status import answer_of
from edge.mission.brief import Brief

if TYPE_CHECKING:
    from edge.loop.service import Service


def handle(service: Service, request: Request, now_ns: int) -> None:
    """Do what is asked and answer how the mission stands, or refuse and change nothing.

    How many new missions a stop kept from beginning is in its answer, as `overtaken`; if there are
    any, it is no mistake to give it when no mission is under way.
    """
    mission = service.mission
    if request.do == "new":
        assert isinstance(request.prepared, Brief)
        try:
            service.begin(request.prepared, now_ns)
        except UserError as error:
            request.refuse(str(error))
            return
    elif request.do != "status" and mission.done:
        if not request.overtaken:
            request.refuse(f"no mission is under way: the last one {service.status.phase}")
            return
    elif request.do == "cancel":
        mission.fail("cancelled", now_ns)
    elif request.do in ("pause", "resume"):
        mission.pause(request.do == "pause")
        service.event(f"mission: {request.do}d", now_ns)
    overtaken = {"overtaken": request.overtaken} if request.overtaken else {}
    request.answer({**answer_of(service.status, facts_of(service.mission)), **overtaken})
