"""Where the running service takes orders about its mission: new, pause, resume, cancel, status.

A desk (`edge.bus.desk`) on `<prefix>/mission/request`. Turning an instruction into a mission takes
seconds where a language model is asked: that is prepared on the desk's own thread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import zenoh

from edge.bus import topics
from edge.bus.desk import PATIENCE_S, Desk, check_text, read_order
from edge.config import Zenoh

_TEXTS = ("instruction", "formula")

Verb = Literal["new", "pause", "resume", "cancel", "status"]
VERBS: tuple[Verb, ...] = ("new", "pause", "resume", "cancel", "status")
STOPS = ("pause", "cancel")
_TAKEN = {verb: _TEXTS if verb == "new" else () for verb in VERBS}


@dataclass(frozen=True)
class Order:
    """What was asked for; `new` has either an instruction or a formula."""

    do: Verb
    instruction: str | None = None
    formula: str | None = None


def parse_order(payload: bytes) -> Order:
    """`{"do": "new", "instruction" | "formula": …}` or `{"do": pause | resume | cancel | status}`.

    Raises:
        ValueError: with one line that says what is wrong.
    """
    do, texts = read_order(payload, _TAKEN)
    if do == "new" and len(texts) != 1:
        raise ValueError("do: new needs either an instruction or a formula")
    return Order(do, **{name: check_text(name, text) for name, text in texts.items()})


class MissionDesk(Desk):
    """Takes orders about the mission; `Request.prepared` of a `new` one is what `prepare` made.

    Args:
        prepare: called as `prepare(instruction, formula)` on a thread of the desk, one at a time;
            raises UserError for what it cannot make a mission of.
        patience_s: how long the loop may take to answer.
    """

    def __init__(
        self,
        session: zenoh.Session,
        settings: Zenoh,
        prepare: Callable[[str | None, str | None], object],
        patience_s: float = PATIENCE_S,
    ) -> None:
        def new(order: Order) -> object:
            return prepare(order.instruction, order.formula)

        key = settings.key(topics.MISSION_REQUEST)
        super().__init__(session, key, parse_order, {"new": new}, STOPS, patience_s)
