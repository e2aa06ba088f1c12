"""Where the running service takes orders about its model: use another one, how that stands.

A desk (`edge.bus.desk`) on `<prefix>/models/request`. `use` is answered as soon as the
swap has begun; `status` says how far it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import zenoh

from edge.bus import topics
from edge.bus.desk import PATIENCE_S, Desk, Request, check_text, read_order
from edge.config import Zenoh
from edge.errors import UserError
from edge.perception.cards import load_detector_card
from edge.perception.swap.swapper import Swapper

MAX_NAME_CHARS = 200

_TAKEN = {"use": ("model", "force"), "status": ()}


@dataclass(frozen=True)
class ModelOrder:
    """What was asked for; `model` is a card's name, of `use` only."""

    do: Literal["use", "status"]
    model: str = ""
    force: bool = False


def parse_order(payload: bytes) -> ModelOrder:
    """`{"do": "use", "model": NAME, "force": true | false}` or `{"do": "status"}`.

    Raises:
        ValueError: with one line that says what is wrong.
    """
    do, data = read_order(payload, _TAKEN)
    if do == "status":
        return ModelOrder("status")
    force = data.get("force", False)
    if not isinstance(force, bool):
        raise ValueError("force: expected true or false")
    return ModelOrder("use", check_text("model", data.get("model"), MAX_NAME_CHARS), force)


class ModelsDesk(Desk):
    """Takes orders about the model; `Request.prepared` of a `use` one is the order, whose card
    was found and is a detector's."""

    def __init__(
        self, session: zenoh.Session, settings: Zenoh, patience_s: float = PATIENCE_S
    ) -> None:
        key = settings.key(topics.MODELS_REQUEST)
        super().__init__(session, key, parse_order, {"use": _check}, patience_s=patience_s)


def _check(order: ModelOrder) -> ModelOrder:
    load_detector_card(order.model)
    return order


def handle(swapper: Swapper, request: Request, now_ns: int) -> None:
    """Begin a swap or change nothing, and answer how the swap stands."""
    if request.do == "use":
        order = request.prepared
        assert isinstance(order, ModelOrder)
        try:
            swapper.request(order.model, order.force, now_ns)
        except UserError as error:
            request.refuse(str(error))
            return
    request.answer(swapper.status())
