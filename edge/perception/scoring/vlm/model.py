"""A published model that answers multiple-choice questions about one view.

A choice needs no generation: the questions are read up to their last token, and the logits of the
answers' tokens are compared. The common beginning of the questions (the rules and the view) is
read once; the rules stay in the cache from one view to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from edge.perception.runtime.card_types import ChoiceCard
from edge.perception.runtime.cards import verify_parts
from edge.perception.runtime.deadline import FIRST_RUN_S, InferenceTimeout
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.onnx_file import check_fixed
from edge.perception.runtime.sessions import DTYPES, TENSORRT_PROVIDERS, open_session
from edge.perception.scoring.vlm.answers import answer_probabilities, answer_token_ids
from edge.perception.scoring.vlm.decoder import Decoder, KeyValueCache
from edge.perception.scoring.vlm.files import common_prefix, read_files, vocabulary
from edge.perception.scoring.vlm.pictures import make_prepare, positions
from edge.perception.scoring.vlm.prompt import Prompter

PROVIDERS_KEY = "perception.choice.providers"
_BLANK_PX = 64


class MultipleChoice(NamedTuple):
    """A question and its possible answers."""

    question: str
    answers: tuple[str, ...]


class LanguageModel:
    """A model, loaded from the files of its card. Call `ask` from one thread at a time.

    Args:
        card: the model's card.
        asked: questions with every answer that will ever be offered; asked once for a test.
        providers, threads, device_id: see `open_session`.

    Attributes:
        name: its card.
        takes_images: True if it takes images, False if it takes text only.

    Raises:
        ModelError: a file is missing, damaged or not of the published layout, the files do not
            match, an answer has no token, or the first run fails.
    """

    def __init__(
        self,
        card: ChoiceCard,
        asked: Sequence[MultipleChoice],
        providers: Sequence[str] = ("CPUExecutionProvider",),
        threads: int = 2,
        device_id: int = 0,
    ) -> None:
        verify_parts(card, believe_cache=True)
        files = read_files(card)

        def open_part(part: Any) -> Any:
            where = card.path_of(part)
            if TENSORRT_PROVIDERS.intersection(providers):
                check_fixed(where, PROVIDERS_KEY)
            return open_session(where, providers, threads, device_id, key=PROVIDERS_KEY)

        self.name, self.takes_images = card.name, card.vision_encoder is not None
        self._card, self._deadline = card, InferenceTimeout(card.name)
        self._prompter = Prompter(files)
        self._ids = self._spelled({answer for one in asked for answer in one.answers})
        self._vision: Any = None
        if self.takes_images:
            token = self._prompter.image_token
            self._prepare = make_prepare(files, token, card.image_tokens)
            self._vision = open_part(card.vision_encoder)
        embedding = open_part(card.embed_tokens) if card.embed_tokens is not None else None
        self._decoder = Decoder(files, open_part(card.decoder), embedding, self._deadline)
        self._kept_ids, self._kept = np.empty(0, np.int64), self._decoder.nothing
        blank = np.zeros((_BLANK_PX, _BLANK_PX, 3), np.uint8)
        self.ask("Be brief.", blank if self.takes_images else "Nothing.", asked, FIRST_RUN_S)

    def _spelled(self, answers: set[str]) -> dict[str, np.ndarray]:
        ordered = sorted(answers)
        found = dict(
            zip(
                ordered,
                answer_token_ids(vocabulary(self._prompter.tokenizer), ordered),
                strict=True,
            )
        )
        if missing := [answer for answer in ordered if not len(found[answer])]:
            raise ModelError(
                f"model {self.name}: its vocabulary has no token for the answer {missing[0]!r}; "
                "take another model"
            )
        return found

    def ask(
        self, rules: str, view: np.ndarray | str, asked: Sequence[MultipleChoice], limit_s: float
    ) -> list[np.ndarray]:
        """Answer questions about one view.

        Args:
            rules: the system message.
            view: (h, w, 3) uint8 RGB for a model that takes images, else text.
            asked: at least one.
            limit_s: time limit of all questions together.

        Returns:
            For each question (n,) float32, the probability of each of its answers (ViTL eq. 4).

        Raises:
            ModelError: it fails, takes too long, or returns values that are not finite; one line.
        """
        with self._deadline.within(limit_s):
            return self._ask(rules, view, asked)

    def _ask(
        self, rules: str, view: np.ndarray | str, asked: Sequence[MultipleChoice]
    ) -> list[np.ndarray]:
        prompter, words = self._prompter, view if isinstance(view, str) else None
        texts = [prompter.text(rules, words, one.question) for one in asked]
        features, grid = np.empty((0, 0), np.float32), None
        if words is None:
            picture = self._prepare(view)
            texts = [text.replace(prompter.image_token, picture.text) for text in texts]
            features, grid = self._image_features(picture.feeds), picture.grid
        ids = [prompter.ids(text) for text in texts]
        self._check_sizes(ids, features)
        shared = min(common_prefix(ids[0], other) for other in ids)
        shared = min(shared, *(len(some) - 1 for some in ids))
        past = self._read(ids[0][:shared], features, grid)
        answered = []
        for some, one in zip(ids, asked, strict=True):
            rows = self._rows(some, past.length, features)
            places = positions(some, prompter.image_id, grid)[:, past.length :]
            logits = self._decoder.next_logits(rows, places, past)
            answered.append(self._shares(logits, one.answers))
        return answered

    def _read(
        self, ids: np.ndarray, features: np.ndarray, grid: tuple[int, int, int] | None
    ) -> KeyValueCache:
        """Return the cache after `ids`; the common beginning with the last call is not read again.

        The image tokens of all images are alike, so only tokens before an image are kept.
        """
        image_id = self._prompter.image_id
        images = np.flatnonzero(ids == image_id) if len(features) else ids[:0]
        keepable = int(images[0]) if len(images) else len(ids)
        known = min(common_prefix(self._kept_ids, ids), keepable)
        past = self._kept.first(known)
        if known < len(ids):
            rows = self._rows(ids, known, features)
            past = self._decoder.read(rows, positions(ids, image_id, grid)[:, known:], past)
        if known < keepable:
            self._kept_ids, self._kept = ids[:keepable], past.first(keepable)
        return past

    def _rows(self, ids: np.ndarray, begin: int, features: np.ndarray) -> np.ndarray:
        """Return the decoder's input from token `begin` on; image features replace image tokens."""
        rows = self._decoder.embed(ids[begin:])
        if len(features):
            is_image = ids == self._prompter.image_id
            before, here = int(is_image[:begin].sum()), is_image[begin:]
            if here.any():
                rows = rows.copy()
                rows[here] = features[before : before + int(here.sum())]
        return rows

    def _image_features(self, feeds: dict[str, np.ndarray]) -> np.ndarray:
        """Return the (n, d) features of an image."""
        taken = {}
        for value in self._vision.get_inputs():
            if value.name not in feeds:
                raise ModelError(
                    f"model {self.name}: its vision encoder needs the input {value.name!r:.40}, "
                    f"but its image processor makes only {', '.join(feeds)}; take another model"
                )
            taken[value.name] = feeds[value.name].astype(DTYPES[value.type], copy=False)
        first = self._vision.get_outputs()[0].name
        features = self._vision.run([first], taken, self._deadline.options)[0]
        return features.reshape(-1, features.shape[-1])

    def _check_sizes(self, ids: Sequence[np.ndarray], features: np.ndarray) -> None:
        for some in ids:
            if len(some) > self._card.max_tokens:
                raise ModelError(
                    f"model {self.name}: a question has {len(some)} tokens, but max_tokens of its "
                    f"card is {self._card.max_tokens}"
                )
            images = int((some == self._prompter.image_id).sum()) if len(features) else 0
            if images != len(features):
                raise ModelError(
                    f"model {self.name}: its vision encoder makes {len(features)} rows of an "
                    f"image, but its prompt has {images} image tokens: the files are of two models"
                )

    def _shares(self, logits: np.ndarray, answers: Sequence[str]) -> np.ndarray:
        ids = [self._ids[answer] for answer in answers]
        if max(int(some.max()) for some in ids) >= len(logits):
            raise ModelError(
                f"model {self.name}: its decoder returns {len(logits)} logits, fewer than its "
                "tokenizer has tokens: the files are of two models"
            )
        p = answer_probabilities(logits, ids)
        if not np.isfinite(p).all():
            raise ModelError(
                f"model {self.name}: logits of the answers are not finite: the model is damaged, "
                "or its precision is too low; take another variant"
            )
        return p

    def close(self) -> None:
        """Abort the current run at once; do not call `ask` afterwards."""
        self._deadline.end()
