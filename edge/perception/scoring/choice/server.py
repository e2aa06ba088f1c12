"""Frontier selection by a chat server (ViTL eq. 4 and 5).

Each mark (a frontier in view) has a letter in the image or the text, and the model names a letter.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from edge.chat import ChatClient, ChatError, make_chat_client
from edge.config import ChoiceOpenai, ChoiceText
from edge.perception.scoring.choice.picture import data_url, draw
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
from edge.perception.scoring.vlm.answers import YES_NO, NoAnswerError, probabilities


@dataclass(frozen=True, slots=True, eq=False)
class ServerPrompt:
    """A view as the server gets it; what `prepare` makes and `answer` takes.

    Attributes:
        part: the part of a message's content with which both questions begin.
        marks: the marks that have a letter, in the letters' order.
    """

    view: MarkedView
    part: dict[str, Any]
    marks: tuple[Mark, ...]


def picture_prompt(max_px: int, view: MarkedView) -> ServerPrompt:
    """Make a prompt with a copy of the image with letters; nothing of the observation is kept.

    Raises:
        ValueError: the observation has no image.
    """
    rgb = view.observation.rgb
    if rgb is None:
        raise ValueError(
            f"observation {view.observation.seq}: it has no camera image to show to the model"
        )
    image, marks = draw(rgb, view.marks, max_px)
    part = {"type": "image_url", "image_url": {"url": data_url(image)}}
    return ServerPrompt(view, part, marks)


def text_prompt(view: MarkedView) -> ServerPrompt:
    """Make a prompt that describes detections and lettered frontiers in words."""
    return ServerPrompt(view, {"type": "text", "text": describe(view)}, view.marks)


class ServerFrontierScorer:
    """A scorer (`edge.perception.worker`) of views, by a chat server.

    The messages of both questions begin with the rules and the view, and differ only at the end. So
    a server with a prompt cache reads the view once.

    Args:
        make_prompt: makes the prompt of a view: `picture_prompt` or `text_prompt`.

    Attributes:
        name: model and server, for people.
    """

    def __init__(
        self, client: ChatClient, make_prompt: Callable[[MarkedView], ServerPrompt]
    ) -> None:
        self.name = f"{client.model} at {client.url}"
        self._client = client
        self._make_prompt = make_prompt

    def prepare(self, view: MarkedView) -> ServerPrompt:
        """Prepare the model's input; the observation is not needed afterwards."""
        return self._make_prompt(view)

    def answer(self, prompt: ServerPrompt) -> FrontierChoice | None:
        """Ask both questions, one after the other, within the client's time limit for both.

        Returns:
            None if no mark could be drawn: there is nothing to choose from.

        Raises:
            ChatError: the server gave no usable answer.
        """
        view, n = prompt.view, len(prompt.marks)
        if n == 0:
            return None
        begin_s = time.monotonic()
        p = self._ask(prompt, direction_question(n, view.target), LETTERS[: n + 1], begin_s)
        scene = self._ask(prompt, scene_question(view.target), YES_NO, begin_s)
        return choice_of(view, prompt.marks, p, float(scene[0]))

    def close(self) -> None:
        """Abort the current request; may be called from another thread."""
        self._client.close()

    def _ask(
        self, prompt: ServerPrompt, question: str, answers: Sequence[str], begin_s: float
    ) -> np.ndarray:
        """Return the probability of each answer to one question, (n,) float32; see `answer`."""
        messages = [
            {"role": "system", "content": SYSTEM},
            {"role": "user", "content": _content(prompt.part, question)},
        ]
        left_s = self._client.time_limit_s - (time.monotonic() - begin_s)
        tokens = self._client.next_tokens(messages, left_s)
        try:
            return probabilities(tokens, answers)
        except NoAnswerError as error:
            raise ChatError(f"{self._client.url}: {error}") from None


def _content(part: dict[str, Any], question: str) -> str | list[dict[str, Any]]:
    """Return the content of a message: one text if both parts are text, else a list.

    Some servers of text models accept no list.
    """
    if part["type"] == "text":
        return f"{part['text']}\n{question}"
    return [part, {"type": "text", "text": question}]


def make_server_scorer(config: ChoiceOpenai | ChoiceText) -> ServerFrontierScorer:
    """Make the scorer that the configuration names; the key comes from the environment.

    Raises:
        ChatError: the URL or the key cannot be used.
    """
    try:
        client = make_chat_client(config, must_live=config.fallback is not None)
    except ChatError as error:
        raise ChatError(f"perception.choice: {error}") from None
    if config.kind == "openai":
        return ServerFrontierScorer(client, partial(picture_prompt, config.max_image_px))
    return ServerFrontierScorer(client, text_prompt)
