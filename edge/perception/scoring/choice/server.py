"""Frontier selection by a chat server (ViTL eq. 4 and 5)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from edge.chat import ChatClient, ChatError, make_chat_client
from edge.config import ChoiceOpenai, ChoiceText
from edge.perception.scoring.choice.letter_scorer import LetterScorer
from edge.perception.scoring.choice.picture import data_url
from edge.perception.scoring.vlm.answers import MultipleChoice, NoAnswerError, probabilities


class ChatModel:
    """A language model on a chat server (`ChoiceModel`).

    The messages of both questions begin with the rules and the view, and differ only at the end. So
    a server with a prompt cache reads the view once.

    Attributes:
        name: model and server, for people.
        takes_images: True if it takes images, False if it takes text only.
    """

    def __init__(self, client: ChatClient, takes_images: bool) -> None:
        self.name, self.takes_images = f"{client.model} at {client.url}", takes_images
        self._client = client

    def ask(
        self,
        rules: str,
        view: np.ndarray | str,
        questions: Sequence[MultipleChoice],
        limit_s: float,
    ) -> list[np.ndarray]:
        """Ask the questions one after the other, within the time limit for all.

        Returns:
            The probability of each answer, (n,) float32, by question.

        Raises:
            ChatError: the server gave no usable answer.
        """
        begin_s, found = time.monotonic(), []
        url = None if isinstance(view, str) else data_url(view)
        for question, answers in questions:
            # Some servers of text models accept no list.
            content: str | list[dict[str, Any]] = f"{view}\n{question}"
            if url is not None:
                image = {"type": "image_url", "image_url": {"url": url}}
                content = [image, {"type": "text", "text": question}]
            messages = [{"role": "system", "content": rules}, {"role": "user", "content": content}]
            left_s = limit_s - (time.monotonic() - begin_s)
            tokens = self._client.next_tokens(messages, left_s)
            try:
                found.append(probabilities(tokens, answers))
            except NoAnswerError as error:
                raise ChatError(f"{self._client.url}: {error}") from None
        return found

    def close(self) -> None:
        """Abort the current request; may be called from another thread."""
        self._client.close()


def make_server_scorer(config: ChoiceOpenai | ChoiceText) -> LetterScorer:
    """Make the scorer that the configuration names; the key comes from the environment.

    Raises:
        ChatError: the URL or the key cannot be used.
    """
    try:
        client = make_chat_client(config, must_live=config.fallback is not None)
    except ChatError as error:
        raise ChatError(f"perception.choice: {error}") from None
    max_px = config.max_image_px if config.kind == "openai" else 0  # text has no image
    return LetterScorer(ChatModel(client, config.kind == "openai"), max_px, config.time_limit_s)
