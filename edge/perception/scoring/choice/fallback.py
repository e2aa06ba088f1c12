"""A choice scorer on a server, with one on this computer for the time in which the server fails."""

from __future__ import annotations

from typing import Any

from edge.perception.runtime.fallback import FallbackModel
from edge.perception.scoring.choice.letter_scorer import LetterScorer
from edge.perception.scoring.choice.question import FrontierChoice, MarkedView


class FallbackScorer:
    """A scorer of views made of two; see `FallbackModel`."""

    def __init__(self, remote: LetterScorer, local: Any) -> None:
        self.name = remote.name
        self._remote, self._local = remote, local
        self._models: FallbackModel[Any, FrontierChoice | None] = FallbackModel(
            "choice", remote.name, local.name, remote.answer
        )

    @property
    def detail(self) -> str:
        """Reason why the local scorer answers; "" while the server does."""
        return self._models.detail

    def prepare(self, view: MarkedView) -> tuple[Any, Any]:
        """Prepare the input of both, since the view is gone when the server has failed.

        An error of the local scorer, such as for a view without an image, is kept for `answer`.
        """
        remote = self._remote.prepare(view)
        try:
            return remote, self._local.prepare(view)
        except Exception as error:
            return remote, error

    def answer(self, prepared: tuple[Any, Any]) -> FrontierChoice | None:
        remote, local = prepared

        def ask_local() -> FrontierChoice | None:
            if isinstance(local, Exception):
                raise local
            return self._local.answer(local)

        return self._models.ask(remote, ask_local)

    def close(self) -> None:
        """Abort the current answers; may be called from another thread."""
        self._remote.close()
        self._models.close()
        self._local.close()
