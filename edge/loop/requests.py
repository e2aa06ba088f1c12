"""What the running service can be asked for, by key, and what the loop does with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from edge.bus import topics
from edge.bus.verbs import Request, Verb, check_text
from edge.errors import UserError
from edge.loop.result import facts_of
from edge.loop.status import answer_of
from edge.mission.brief import Brief
from edge.perception.cards import load_detector_card
from edge.perception.swap.swapper import Swapper

if TYPE_CHECKING:
    from edge.loop.service import Service

MAX_NAME_CHARS = 200


def served(
    service: Service, prepare: Callable[..., Brief]
) -> dict[str, tuple[Mapping[str, Verb], Callable[[Request, int], dict]]]:
    """What can be asked for and what does it, by key below the prefix; see `RequestServer`.

    Args:
        prepare: makes a mission of an `instruction` or a `formula`; see `edge.mission.brief`.
    """
    return {
        topics.MISSION_REQUEST: (mission_verbs(prepare), partial(handle_mission, service)),
        topics.MODELS_REQUEST: (MODEL_VERBS, partial(handle_model, service.swapper)),
    }


def mission_verbs(prepare: Callable[..., object]) -> dict[str, Verb]:
    """`{"do": "new", "instruction" | "formula": …}`, `{"do": pause | resume | cancel | status}`.

    Turning an instruction into a mission takes seconds where a language model is asked, so that
    is prepared.
    """
    return {
        "new": Verb(("instruction", "formula"), _one_text, lambda fields: prepare(**fields)),
        "pause": Verb(stops=True),
        "resume": Verb(),
        "cancel": Verb(stops=True),
        "status": Verb(reads=True),
    }


def _one_text(fields: dict) -> dict:
    if len(fields) != 1:
        raise ValueError("do: new needs either an instruction or a formula")
    return {name: check_text(name, text) for name, text in fields.items()}


def handle_mission(service: Service, request: Request, now_ns: int) -> dict:
    """Do what is asked and answer how the mission stands, or refuse and change nothing.

    How many new missions a stop kept from beginning is in its answer, as `overtaken`; if there are
    any, it is no mistake to ask for it when no mission is under way.

    Raises:
        UserError: there is nothing to pause, resume or cancel, or the mission cannot be begun.
    """
    mission = service.mission
    if request.do == "new":
        assert isinstance(request.prepared, Brief)
        service.begin(request.prepared, now_ns)
    elif request.do != "status" and mission.done:
        if not request.overtaken:
            phase = service.status.phase
            raise UserError(f"no mission is under way: the last one {phase}")
    elif request.do == "cancel":
        service.fail("cancelled", now_ns)
    elif request.do in ("pause", "resume"):
        service.pause(request.do == "pause", now_ns)
    overtaken = {"overtaken": request.overtaken} if request.overtaken else {}
    return {**answer_of(service.status, facts_of(service.mission)), **overtaken}


def _model(fields: dict) -> dict:
    force = fields.get("force", False)
    if not isinstance(force, bool):
        raise ValueError("force: expected true or false")
    return {"model": check_text("model", fields.get("model"), MAX_NAME_CHARS), "force": force}


MODEL_VERBS = {
    "use": Verb(("model", "force"), _model, lambda fields: load_detector_card(fields["model"])),
    "status": Verb(reads=True),
}
"""`{"do": "use", "model": NAME, "force": true | false}` or `{"do": "status"}`; the card of a model
is found, and a detector's, before the loop hears of it."""


def handle_model(swapper: Swapper, request: Request, now_ns: int) -> dict:
    """Answer how the swap stands, once it has begun if that is asked for.

    Raises:
        SwapError: it cannot be begun.
    """
    if request.do == "use":
        swapper.request(request.fields["model"], request.fields["force"], now_ns)
    return swapper.status()
