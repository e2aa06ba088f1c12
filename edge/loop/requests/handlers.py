"""Requests about missions that the running service handles, and the table of all keys.

Each key has verbs (`{"do": VERB}`) and a handler. A function `_check_…` checks the fields of a verb
on the request thread, and raises ValueError with the name of a bad field. The handlers run on the
loop's thread.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from edge.bus import topics
from edge.bus.verbs import CANCELLED, Request, Verb, check_flag, check_pose, check_text, show
from edge.config import TranslatorLtl
from edge.errors import UserError
from edge.loop.behaviours.room_targets import refuse_closed
from edge.loop.requests.intent_requests import carry_out
from edge.loop.requests.memory_requests import MEMORY_VERBS, handle_memory
from edge.loop.requests.model_requests import MODEL_VERBS, ModelRequests
from edge.loop.requests.site_requests import SITE_VERBS, handle_site
from edge.loop.result import mission_facts
from edge.loop.status import reply_json
from edge.mission.destinations import LONGEST_S, PlaceTarget
from edge.mission.language.intents import (
    Control,
    MemoryQuestion,
    NoMissionError,
    SiteOrder,
    understand,
)
from edge.mission.repetition import MAX_ROUNDS, Repetition
from edge.mission.spec import MissionSpec
from edge.mission.translate import TranslationError
from edge.text import bounded_repr, one_line

if TYPE_CHECKING:
    from edge.loop.service import Service

_MAX_WHY_CHARS = 200
# Ids of missions: also safe as file names and in URLs.
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._~-]{0,63}")


def request_handlers(
    service: Service,
    prepare: Callable[..., MissionSpec],
    problems: Callable[[], Sequence[str]] = tuple,
) -> dict[str, tuple[Mapping[str, Verb], Callable[[Request, int], dict]]]:
    """Return the verbs and the handler of each request key below the prefix; see `RequestServer`.

    Args:
        service: The running service.
        prepare: Makes a mission of an `instruction`, a `formula` or a `task`; see
            `edge.tasks.mission_spec`.
        problems: Returns the reasons why the service is not ready; see
            `edge.loop.monitoring.service_health`.
    """
    in_words = not isinstance(service.config.mission.translator, TranslatorLtl)
    return {
        topics.MISSION_REQUEST: (
            mission_verbs(prepare, in_words),
            partial(handle_mission, service, problems=problems),
        ),
        topics.MODELS_REQUEST: (
            MODEL_VERBS,
            ModelRequests(service.detector_swap, service.perception.scorers).handle,
        ),
        topics.SITE_REQUEST: (SITE_VERBS, partial(handle_site, service)),
        topics.MEMORY_REQUEST: (MEMORY_VERBS, partial(handle_memory, service)),
    }


def mission_verbs(prepare: Callable[..., object], in_words: bool = False) -> dict[str, Verb]:
    """Return the verbs of mission requests.

    Args:
        prepare: see `request_handlers`.
        in_words: True if instructions are English, so that "stop" is an order to stop.

    The requests are `{"do": "new", "instruction" | "formula" | "task": …}` and `{"do": VERB}` with
    pause, resume, confirm, cancel, again or status.

    A new mission is prepared on the request thread, because a language model may take seconds to
    translate an instruction.

    A new mission may have an `id` of the client's choice. A second request with the same id does
    not start it again. An ambiguous or doubtful instruction is refused with its `readings` and with
    `doubts` about single words. The field `reading` chooses one of the readings, counted from 1.

    With `from_pose: [x_m, y_m, yaw_rad]`, the mission may name the place `caller`.

    With `rounds` or `for_s`, the mission repeats so often, or for so many seconds.

    A pause ends after `for_s` seconds, if it has that field.

    With `if_free: true`, the request is refused while another mission runs. `cancel` with an `id`
    cancels only that mission; its `why` becomes the reason.

    An instruction that is a question, or an order to learn a place or zone, leaves the mission as
    it is; the answer has `text`. An instruction like "pause" is the request with that verb.
    """

    return {
        "new": Verb(
            (*_INSTRUCTION_FIELDS, "reading", "from_pose", "rounds", "for_s", "id", "if_free"),
            _check_new,
            partial(prepare_new, prepare),
            # The instruction "stop" becomes a request with another verb.
            instead=_as_control if in_words else lambda fields: None,
        ),
        "pause": Verb(("for_s",), _check_pause, stops_robot=True),
        "resume": Verb(),
        "confirm": Verb(),
        "cancel": Verb(("id", "why"), _check_cancel, stops_robot=True),
        "again": Verb(),
        "status": Verb(read_only=True),
    }


def prepare_new(prepare: Callable[..., object], fields: dict) -> object:
    """Prepare a new mission; for a question or an order to learn, return that instead."""
    try:
        return prepare(**{name: fields[name] for name in _PREPARED_FIELDS if name in fields})
    except NoMissionError as error:
        if isinstance(error.intent, Control):
            raise
        return error.intent


_INSTRUCTION_FIELDS = ("instruction", "formula", "task")
_PREPARED_FIELDS = (*_INSTRUCTION_FIELDS, "reading", "caller", "repeat")  # arguments of `prepare`


def _check_new(fields: dict) -> dict:
    texts = {name: check_text(name, fields[name]) for name in _INSTRUCTION_FIELDS if name in fields}
    if len(texts) != 1:
        raise ValueError("do: new needs exactly one of the fields instruction, formula and task")
    if_free = {"if_free": True} if check_flag("if_free", fields) else {}
    return {
        **texts,
        **_check_reading(fields),
        **_check_caller(fields),
        **check_repetition(fields),
        **_check_id(fields),
        **if_free,
    }


def _check_caller(fields: dict) -> dict:
    """Return the field `from_pose` as the pose `caller`, if present."""
    if "from_pose" not in fields:
        return {}
    if "task" in fields:
        raise ValueError("from_pose: only valid with an instruction or a formula")
    return {"caller": check_pose("from_pose", fields["from_pose"])}


def _check_pause(fields: dict) -> dict:
    """Return the field `for_s`, if present: the pause ends after so many seconds."""
    return {"for_s": _check_seconds(fields["for_s"])} if "for_s" in fields else {}


def _as_control(fields: dict) -> tuple[str, dict] | None:
    """Return the request that an instruction about the present mission means; None for others."""
    try:
        intent = understand(fields.get("instruction", ""))
    except TranslationError:
        return None  # the preparation reports it
    if not isinstance(intent, Control):
        return None
    return intent.do, {} if intent.seconds is None else {"for_s": intent.seconds}


def _check_reading(fields: dict) -> dict:
    """Return the field `reading`, if present."""
    if "reading" not in fields:
        return {}
    reading = fields["reading"]
    if type(reading) is not int or reading < 1:
        raise ValueError(
            f"reading: expected the number of a reading, 1 or more, got {show(reading)}"
        )
    if "instruction" not in fields:
        raise ValueError("reading: this field is only valid with the field instruction")
    return {"reading": reading}


def check_repetition(fields: dict) -> dict:
    """Return the fields `rounds` and `for_s` as a `Repetition`, if present."""
    rounds, for_s = fields.get("rounds"), fields.get("for_s")
    if rounds is None and for_s is None:
        return {}
    if "task" in fields:
        raise ValueError("rounds, for_s: only valid with an instruction or a formula")
    if rounds is not None and (type(rounds) is not int or not 1 <= rounds <= MAX_ROUNDS):
        raise ValueError(f"rounds: expected an integer from 1 to {MAX_ROUNDS}, got {show(rounds)}")
    return {"repeat": Repetition(rounds, None if for_s is None else _check_seconds(for_s))}


def _check_seconds(for_s: object) -> float:
    """Return the value of `for_s` after a check."""
    if not isinstance(for_s, (int, float)) or type(for_s) is bool or not 0 < for_s <= LONGEST_S:
        raise ValueError(
            f"for_s: expected a time above 0 s, at most {LONGEST_S:g} s, got {show(for_s)}"
        )
    return for_s


def _check_cancel(fields: dict) -> dict:
    """Return the fields `id` and `why`, if present."""
    why = {"why": check_text("why", fields["why"], _MAX_WHY_CHARS)} if "why" in fields else {}
    return {**_check_id(fields), **why}


def _check_id(fields: dict) -> dict:
    """Return the field `id`, if present."""
    if "id" not in fields:
        return {}
    if not _ID.fullmatch(check_text("id", fields["id"])):
        raise ValueError(
            "id: expected at most 64 letters, digits and . _ ~ -, starting with a letter or digit, "
            f"got {bounded_repr(fields['id'])}"
        )
    return {"id": fields["id"]}


def handle_mission(
    service: Service, request: Request, now_ns: int, problems: Callable[[], Sequence[str]] = tuple
) -> dict:
    """Handle a mission request and return the status of mission and robot.

    A pause or cancel also drops the new missions that still wait for their preparation
    (`Request.cancelled` is their number). The reply has this number as `overtaken`. If there are
    any, the request succeeds even if no mission is running.

    Raises:
        UserError: There is nothing to pause, resume, cancel or start again, or the mission cannot
            be started. Nothing has changed then.
    """
    mission, name, answer = service.mission, request.fields.get("id", ""), {}
    if isinstance(request.prepared, (MemoryQuestion, SiteOrder)):
        answer = {"text": carry_out(service, request.prepared, now_ns)}
    elif request.do == "new":
        _begin(service, request, now_ns)
    elif request.do == "again":
        _begin_again(service, now_ns)
    elif request.do != "status" and (mission.done or name not in ("", mission.id)):
        if not request.cancelled:  # else it has stopped missions that waited: no error
            which = f"{one_line(name)} " if name else ""
            raise UserError(f"no mission {which}is running: {_last_mission_text(service)}")
    elif request.do == "cancel":
        service.control.cancel(one_line(request.fields.get("why", CANCELLED)), now_ns)
    elif request.do == "confirm":
        service.control.confirm(now_ns)
    elif request.do in ("pause", "resume"):
        service.control.pause(request.do == "pause", now_ns, request.fields.get("for_s"))
    task = service.behaviour.task_status()
    overtaken = {"overtaken": request.cancelled} if request.cancelled else {}
    return {
        **reply_json(service.status, mission_facts(service.mission), task),
        **overtaken,
        **answer,
        "past": list(service.control.past),
        "robot": _robot_state(service, problems()),
    }


def _begin(service: Service, request: Request, now_ns: int) -> None:
    """Start the requested mission, unless its id was used before or the robot must be free."""
    assert isinstance(request.prepared, MissionSpec)
    name, mission = request.fields.get("id", ""), service.mission
    if name and name == mission.id:  # the same request once more
        return
    if name and any(name == outcome["id"] for outcome in service.control.past):
        raise UserError(
            f"mission {name} is already over on this robot: give the new mission another id"
        )
    if request.fields.get("if_free") and not mission.done:
        raise UserError(
            f"not free: {_last_mission_text(service)}; wait for its end, or cancel this mission"
        )
    refuse_closed(request.prepared, service.site.known, service.map)
    service.begin(request.prepared, now_ns, name)


def _begin_again(service: Service, now_ns: int) -> None:
    """Start the last mission once more, with its places where they are now."""
    mission = service.mission
    if mission.ended == "idle" or not mission.done:
        still = "" if mission.ended == "idle" else "; it still runs, so cancel it first"
        raise UserError(f"cannot start it again: {_last_mission_text(service)}{still}")
    spec, site, found = mission.spec, service.site.known, {}
    for name, destination in spec.translation.destinations.items():
        found[name] = destination
        if isinstance(destination, PlaceTarget) and destination.pose is not None:
            if (place := site.place(name)) is None:
                raise UserError(
                    f"cannot start it again: no place {one_line(name, 60)} is known now"
                )
            found[name] = PlaceTarget(place.pose)  # it may have been moved
    spec = replace(spec, translation=replace(spec.translation, destinations=found))
    refuse_closed(spec, site, service.map)
    service.begin(spec, now_ns)


def _last_mission_text(service: Service) -> str:
    """Return one line about the newest mission, for an error."""
    if service.mission.ended == "idle":
        return "no mission was given yet"
    return f"the last mission {service.status.phase}: {service.status.instruction}"


def _robot_state(service: Service, problems: Sequence[str]) -> dict[str, object]:
    """Return the state of the robot for the reply, JSON-ready.

    `known` is the straight-line distance in metres to the nearest object of each label in the map.
    """
    pose, goals = service.pose, service.goals
    known: dict[str, float] = {}
    min_hits = service.config.perception.min_hits
    for found in service.map.tracker.all:
        if pose is not None and found.state != "rejected" and found.hits >= min_hits:
            away_m = round(pose.distance_to(*map(float, found.center_m[:2])), 2)
            known[found.label] = min(away_m, known.get(found.label, away_m))
    return {
        "pose": None if pose is None else [pose.x_m, pose.y_m, pose.yaw_rad],
        "controller": "answers" if goals.client.has_controller else "silent",
        "stopped": service.control.stopped,
        "problems": [one_line(why) for why in problems],
        "known": known,
    }
