"""Frontier selection by a language model (ViTL eq. 4 and 5).

Each mark (a frontier in view) has a letter in the image or the text, and the model names a letter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from edge.perception.runtime.model_file import ModelError
from edge.perception.scoring.choice.picture import draw
from edge.perception.scoring.choice.question import (
    LETTERS,
    SYSTEM,
    FrontierChoice,
    Mark,
    MarkedView,
    choice_of,
    describe,
    direction_question,
    scene_question,
)
from edge.perception.scoring.vlm.answers import YES_NO, MultipleChoice


class ChoiceModel(Protocol):
    """A language model: `LanguageModel`, in its own process `ProcessModel`, or a `ChatModel`."""

    name: str
    takes_images: bool

    def ask(
        self,
        rules: str,
        view: np.ndarray | str,
        questions: Sequence[MultipleChoice],
        limit_s: float,
    ) -> list[np.ndarray]: ...

    def close(self) -> None: ...


class ModelPrompt(NamedTuple):
    """A view as the model gets it; what `prepare` makes and `answer` takes.

    Attributes:
        part: an image with letters, (h, w, 3) uint8, or text.
        marks: the marks that have a letter, in the letters' order.
    """

    view: MarkedView
    part: np.ndarray | str
    marks: tuple[Mark, ...]


class LetterScorer:
    """A scorer (`edge.perception.worker`) of views, by a language model.

    Attributes:
        name: name of the model, for people.
    """

    def __init__(self, model: ChoiceModel, max_image_px: int, time_limit_s: float) -> None:
        self.name = model.name
        self._model, self._max_px, self._limit_s = model, max_image_px, time_limit_s

    def prepare(self, view: MarkedView) -> ModelPrompt:
        """Prepare the model's input; the observation is not needed afterwards.

        Raises:
            ModelError: the model takes images, and the observation has none.
        """
        if not self._model.takes_images:
            return ModelPrompt(view, describe(view), view.marks)
        rgb = view.observation.rgb
        if rgb is None:
            raise ModelError(
                f"model {self.name}: cannot choose a direction: observation "
                f"{view.observation.seq} has no camera image"
            )
        return ModelPrompt(view, *draw(rgb, view.marks, self._max_px))

    def answer(self, prompt: ModelPrompt) -> FrontierChoice | None:
        """Ask both questions.

        Returns:
            None if no mark could be drawn: there is nothing to choose from.

        Raises:
            ModelError, ChatError: the model gave no usable answer within the time limit; one line.
        """
        view, n = prompt.view, len(prompt.marks)
        if n == 0:
            return None
        p, scene = self._model.ask(
            SYSTEM, prompt.part, both_questions(n, view.target), self._limit_s
        )
        return choice_of(view, prompt.marks, p, float(scene[0]))

    def close(self) -> None:
        """Abort the current question; may be called from another thread."""
        self._model.close()


def both_questions(n_marks: int, target: str) -> tuple[MultipleChoice, MultipleChoice]:
    """Return both questions of ViTL IV-B1 with their possible answers."""
    return (
        MultipleChoice(direction_question(n_marks, target), tuple(LETTERS[: n_marks + 1])),
        MultipleChoice(scene_question(target), YES_NO),
    )
