"""What the running service can be asked for, by key, and what the loop does with it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from edge.bus import topics
from edge.bus.verbs import CANCELLED, Request, Verb, check_flag, check_text, shown
from edge.errors import UserError
from edge.loop.memory_requests import MEMORY_VERBS, handle_memory
from edge.loop.result import facts_of
from edge.loop.site_requests import SITE_VERBS, handle_site
from edge.loop.status import answer_of
from edge.mission.brief import Brief
from edge.perception.runtime.card_types import DetectCard, DirectionsCard
from edge.perception.runtime.cards import load_card, load_detector_card
from edge.perception.swap.base import SwapError
from edge.perception.swap.detector import DetectorSwap
from edge.text import bounded_repr, one_line

if TYPE_CHECKING:
    from edge.loop.scorers import Scorers
    from edge.loop.service import Service

MAX_NAME_CHARS = 200
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._~-]{0,63}")


def served(
    service: Service,
    prepare: Callable[..., Brief],
    amiss: Callable[[], Sequence[str]] = tuple,
) -> dict[str, tuple[Mapping[str, Verb], Callable[[Request, int], dict]]]:
    """What can be asked for and what does it, by key below the prefix; see `RequestServer`.

    Args:
        prepare: makes a mission of an `instruction` or a `formula`, or of a `task`; see
            `edge.tasks.brief`.
        amiss: why nobody can count on the service now; see `edge.loop.vitals`.
    """
    return {
        topics.MISSION_REQUEST: (
            mission_verbs(prepare),
            partial(handle_mission, service, amiss=amiss),
        ),
        topics.MODELS_REQUEST: (
            MODEL_VERBS,
            partial(handle_model, service.swapper, scorers=service.scorers),
        ),
        topics.SITE_REQUEST: (SITE_VERBS, partial(handle_site, service)),
        topics.MEMORY_REQUEST: (MEMORY_VERBS, partial(handle_memory, service)),
    }


def mission_verbs(prepare: Callable[..., object]) -> dict[str, Verb]:
    """`{"do": "new", "instruction" | "formula" | "task": …}`, `{"do": VERB}` with pause, resume,
    cancel or status.

    Turning an instruction into a mission takes seconds where a language model is asked, so that
    is prepared.

    A new mission may have an `id`, by which whoever gave it knows it again; given once more, it
    is not begun anew. An instruction that can be read in several ways, or in one that is not sure,
    is refused with its `readings` and with `doubts` of single words; `reading` chooses one, counted
    from 1.

    With `if_free: true` it takes no other's place. `cancel` with an `id` ends that mission and no
    other; its `why` becomes the reason.
    """
    return {
        "new": Verb(
            (*_TEXTS, "reading", "id", "if_free"),
            _new,
            lambda fields: prepare(**{name: fields[name] for name in _MEANT if name in fields}),
        ),
        "pause": Verb(stops=True),
        "resume": Verb(),
        "cancel": Verb(("id", "why"), _cancel, stops=True),
        "status": Verb(reads=True),
    }


_TEXTS = ("instruction", "formula", "task")
_MEANT = (*_TEXTS, "reading")


def _new(fields: dict) -> dict:
    texts = {name: check_text(name, fields[name]) for name in _TEXTS if name in fields}
    if len(texts) != 1:
        raise ValueError("do: new needs either an instruction, a formula or a task")
    free = {"if_free": True} if check_flag("if_free", fields) else {}
    return {**texts, **_chosen(fields), **_named(fields), **free}


def _chosen(fields: dict) -> dict:
    """The `reading`, where there is one."""
    if "reading" not in fields:
        return {}
    reading = fields["reading"]
    if type(reading) is not int or reading < 1:
        raise ValueError(f"reading: expected a number from 1 on, got {shown(reading)}")
    if "instruction" not in fields:
        raise ValueError("reading: only an instruction has readings")
    return {"reading": reading}


def _cancel(fields: dict) -> dict:
    why = {"why": check_text("why", fields["why"], MAX_NAME_CHARS)} if "why" in fields else {}
    return {**_named(fields), **why}


def _named(fields: dict) -> dict:
    """The `id`, where there is one."""
    if "id" not in fields:
        return {}
    if not _ID.fullmatch(check_text("id", fields["id"])):
        raise ValueError(
            f"id: expected letters, digits and . _ ~ -, 64 at most: {bounded_repr(fields['id'])}"
        )
    return {"id": fields["id"]}


def handle_mission(
    service: Service, request: Request, now_ns: int, amiss: Callable[[], Sequence[str]] = tuple
) -> dict:
    """Do what is asked and answer how mission and robot stand, or refuse and change nothing.

    How many new missions a stop kept from beginning is in its answer, as `overtaken`; if there are
    any, it is no mistake to ask for it when no mission is under way.

    Raises:
        UserError: there is nothing to pause, resume or cancel, or the mission cannot be begun.
    """
    mission, name = service.mission, request.fields.get("id", "")
    if request.do == "new":
        _begin(service, request, now_ns)
    elif request.do != "status" and (mission.done or name not in ("", mission.id)):
        if not request.overtaken:
            raise UserError(f"no {'such ' * bool(name)}mission is under way: {_last(service)}")
    elif request.do == "cancel":
        service.fail(one_line(request.fields.get("why", CANCELLED)), now_ns)
    elif request.do in ("pause", "resume"):
        service.pause(request.do == "pause", now_ns)
    task = service.behaviour.facts()
    overtaken = {"overtaken": request.overtaken} if request.overtaken else {}
    return {
        **answer_of(service.status, facts_of(service.mission), task),
        **overtaken,
        "past": list(service.past),
        "robot": _robot(service, amiss()),
    }


def _begin(service: Service, request: Request, now_ns: int) -> None:
    """Begin what was asked for, unless that was done before, or the robot is to be free for it."""
    assert isinstance(request.prepared, Brief)
    name, mission = request.fields.get("id", ""), service.mission
    if name and name == mission.id:
        return
    if name and any(name == outcome["id"] for outcome in service.past):
        raise UserError(f"mission {name} is over here")
    if request.fields.get("if_free") and not mission.done:
        raise UserError(f"not free: {_last(service)}")
    service.begin(request.prepared, now_ns, name)


def _last(service: Service) -> str:
    if service.mission.idle:
        return "none was given yet"
    return f"the last one {service.status.phase}: {service.status.instruction}"


def _robot(service: Service, amiss: Sequence[str]) -> dict[str, object]:
    """Whether the robot can take a mission on, and what it knows of the world.

    `known`: metres, as the crow flies, to the nearest thing of each label in the map.
    """
    pose, goals = service.pose, service.goals
    known: dict[str, float] = {}
    least = service.config.perception.min_hits
    for found in service.map.tracker.all:
        if pose is not None and found.state != "refuted" and found.hits >= least:
            away_m = round(pose.distance_to(*map(float, found.center_m[:2])), 2)
            known[found.label] = min(away_m, known.get(found.label, away_m))
    return {
        "pose": None if pose is None else [pose.x_m, pose.y_m, pose.yaw_rad],
        "controller": "answers" if goals.client.heard else "silent",
        "amiss": [one_line(why) for why in amiss],
        "known": known,
    }


def _model(fields: dict) -> dict:
    name = check_text("model", fields.get("model"), MAX_NAME_CHARS)
    return {"model": name, "force": check_flag("force", fields)}


def _card_to_use(fields: dict) -> DetectCard | DirectionsCard:
    """Raises ModelError for no card, and for one that nothing can be swapped for."""
    card = load_card(fields["model"])
    return card if isinstance(card, DirectionsCard) else load_detector_card(fields["model"])


MODEL_VERBS = {
    "use": Verb(("model", "force"), _model, _card_to_use),
    "pause": Verb(),
    "resume": Verb(),
    "status": Verb(reads=True),
}
"""`{"do": "use", "model": NAME, "force": true | false}`, `{"do": "status"}`, or
`{"do": "pause" | "resume"}` for the scorers; the card of a model is found, and one that can be
swapped in, before the loop hears of it."""


def handle_model(
    swapper: DetectorSwap, request: Request, now_ns: int, scorers: Scorers | None = None
) -> dict:
    """Answer how the newest swap stands, once it has begun if that is asked for.

    Raises:
        SwapError: it cannot be begun.
        UserError: there are no scorers to be paused.
    """
    choices = None if scorers is None else scorers.swap
    if request.do in ("pause", "resume"):
        if scorers is None:
            raise UserError("no scorers are configured: nothing to pause")
        scorers.paused = request.do == "pause"
    elif request.do == "use" and isinstance(request.prepared, DirectionsCard):
        if scorers is None or choices is None:
            raise SwapError(
                "no model that runs here chooses directions: set perception.choice.kind to onnx"
            )
        choices.request(request.fields["model"])
        scorers.newest_swap = True
    elif request.do == "use":
        swapper.request(request.fields["model"], request.fields["force"], now_ns)
        if scorers is not None:
            scorers.newest_swap = False
    if scorers is None or choices is None:
        return swapper.status()
    newest = choices if scorers.newest_swap else swapper
    # One count for both: whoever follows a swap sees that another has begun.
    number = swapper.number + choices.number
    return {**newest.status(), "number": number, "paused": scorers.paused}
