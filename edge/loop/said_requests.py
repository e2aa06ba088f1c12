"""Answers to what a person says that is no mission: questions and orders to learn."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from edge import names
from edge.bus.verbs import Request, Verb, read_request
from edge.errors import UserError
from edge.loop.memory_requests import MEMORY_VERBS, handle_memory
from edge.loop.site_requests import SITE_VERBS, handle_site
from edge.memory.site import is_same
from edge.mission.language.said import Question, SiteOrder
from edge.text import one_line

if TYPE_CHECKING:
    from edge.loop.service import Service

_MOST_TOLD = 20


def carry_out(service: Service, said: Question | SiteOrder, now_ns: int) -> str:
    """Answer a question, or change the site as told; return the answer in one line.

    Raises:
        UserError: it cannot be done. Nothing has changed then.
    """
    if isinstance(said, Question):
        return _answer(service, said, now_ns)
    return _learn(service, said, now_ns)


def _asked(
    handle: Any, verbs: Mapping[str, Verb], service: Service, now_ns: int, **data: Any
) -> dict:
    """Return the answer to a request of the service's own."""
    try:
        do, fields = read_request(json.dumps(data).encode(), verbs)
    except ValueError as error:
        raise UserError(str(error)) from error
    answer: dict = handle(service, Request(do, fields), now_ns)
    return answer


def _answer(service: Service, said: Question, now_ns: int) -> str:
    if said.topic in ("where", "exists"):
        answer = _asked(
            handle_memory,
            MEMORY_VERBS,
            service,
            now_ns,
            do="find",
            name=names.head_phrase(said.about),
        )
        yes = "yes, " if said.topic == "exists" and answer["objects"] else ""
        return f"{yes}{answer['text']}"
    if said.topic == "seen":
        answer = _asked(handle_memory, MEMORY_VERBS, service, now_ns, do="list")
        return _listed("seen", [one["name"] for one in answer["objects"]])
    if said.topic == "places":
        return _listed("places", [place.name for place in service.site.known.places])
    if said.topic == "rooms":
        return str(_asked(handle_memory, MEMORY_VERBS, service, now_ns, do="rooms")["text"])
    if service.pose is None:
        raise UserError("the robot's pose is not known yet: wait for the first observation")
    return f"at ({service.pose.x_m:.1f}, {service.pose.y_m:.1f})"


def _listed(what: str, found: list[str]) -> str:
    """Return the names with their numbers, the most frequent first."""
    counts = Counter(found).most_common(_MOST_TOLD)
    shown = [f"{n} × {one_line(name)}" if n > 1 else one_line(name) for name, n in counts]
    more = ", …" if len(set(found)) > _MOST_TOLD else ""
    return f"{what}: {', '.join(shown) or 'none'}{more}"


def _learn(service: Service, said: SiteOrder, now_ns: int) -> str:
    data: dict[str, Any]
    if said.do == "place":
        data = {"do": "set", "name": said.name}
    elif said.do == "room":
        data = {"do": "set", "kind": "room", "name": said.name}
    elif said.do in ("keep_out", "stay_inside"):
        data = {"do": "set", "kind": said.do, "room": said.name}
    else:
        zones = [zone.name for zone in service.site.site.zones]
        if said.do == "open" and not any(is_same(name, said.name) for name in zones):
            listed = one_line(", ".join(zones) or "none")
            raise UserError(f"{one_line(said.name)}: no zone of this name (zones: {listed})")
        data = {"do": "remove", "name": said.name}
    return str(_asked(handle_site, SITE_VERBS, service, now_ns, **data)["text"])
