"""Requests about models: swap the detector or the choice scorer, and pause the scorers.

`edge models use` sends them, with the key `models/request`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from edge.bus.verbs import Request, Verb, check_flag, check_text
from edge.errors import UserError
from edge.perception.runtime.card_types import DetectCard, DirectionsCard
from edge.perception.runtime.cards import load_card, load_detector_card
from edge.perception.swap.base import SwapError
from edge.perception.swap.choice import ChoiceSwap
from edge.perception.swap.detector import DetectorSwap

if TYPE_CHECKING:
    from edge.loop.scoring.scorers import Scorers

_MAX_NAME_CHARS = 200


def _check_model(fields: dict) -> dict:
    """Return the fields `model` and `force`."""
    name = check_text("model", fields.get("model"), _MAX_NAME_CHARS)
    return {"model": name, "force": check_flag("force", fields)}


def _card_to_use(fields: dict) -> DetectCard | DirectionsCard:
    """Return the card of the model. Raise ModelError if it has no card or cannot be swapped in."""
    card = load_card(fields["model"])
    return card if isinstance(card, DirectionsCard) else load_detector_card(fields["model"])


MODEL_VERBS = {
    "use": Verb(("model", "force"), _check_model, _card_to_use),
    "pause": Verb(),
    "resume": Verb(),
    "status": Verb(read_only=True),
}
"""Verbs of model requests: `{"do": "use", "model": NAME, "force": true | false}`,
`{"do": "status"}`, and `{"do": "pause" | "resume"}` for the scorers. The card of a model is checked
before the request reaches the loop."""


class ModelRequests:
    """Handler of model requests; for the loop's thread.

    Args:
        detector_swap: Swaps the detector's model.
        scorers: The scorers; None if none are configured.
    """

    def __init__(self, detector_swap: DetectorSwap, scorers: Scorers | None = None) -> None:
        self._detector_swap, self._scorers = detector_swap, scorers
        self._newest: DetectorSwap | ChoiceSwap = detector_swap  # that of the last swap request

    def handle(self, request: Request, now_ns: int) -> dict:
        """Handle a model request and return the status of the newest swap.

        Raises:
            SwapError: The swap cannot be started.
            UserError: There are no scorers to pause.
        """
        detector_swap, scorers = self._detector_swap, self._scorers
        choice_swap = None if scorers is None else scorers.swap
        if request.do in ("pause", "resume"):
            if scorers is None:
                raise UserError("no scorers are configured: there is nothing to pause or resume")
            scorers.paused = request.do == "pause"
        elif request.do == "use" and isinstance(request.prepared, DirectionsCard):
            if choice_swap is None:
                raise SwapError(
                    "no model on this computer chooses directions: set perception.choice.kind to "
                    "onnx"
                )
            choice_swap.request(request.fields["model"])
            self._newest = choice_swap
        elif request.do == "use":
            detector_swap.request(request.fields["model"], request.fields["force"], now_ns)
            self._newest = detector_swap
        if scorers is None or choice_swap is None:
            return detector_swap.status()
        # One number for both, so that a client that follows a swap sees that another has started.
        number = detector_swap.number + choice_swap.number
        return {**self._newest.status(), "number": number, "paused": scorers.paused}
