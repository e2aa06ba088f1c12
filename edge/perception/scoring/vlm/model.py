"""A published model that answers multiple-choice questions about one view.

The model generates no text. It reads a question up to the last token, and the logits of the
answers' tokens are compared. The common beginning of the questions (the rules and the view) is read
once. The rules stay in the cache from one view to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from edge.perception.runtime.card_types import ChoiceCard
from edge.perception.runtime.cards import verify_parts
from edge.perception.runtime.deadline import FIRST_RUN_S, InferenceTimeout
from edge.perception.runtime.engines import EngineOptions
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.sessions import DTYPES, TENSORRT_PROVIDERS, open_session
from edge.perception.scoring.vlm.answers import (
    MultipleChoice,
    answer_probabilities,
    answer_token_ids,
)
from edge.perception.scoring.vlm.decoder import Decoder, KeyValueCache
from edge.perception.scoring.vlm.files import common_prefix, read_files, vocabulary
from edge.perception.scoring.vlm.pictures import make_prepare, positions
from edge.perception.scoring.vlm.prompt import Prompter

_BLANK_PX = 64  # side of the image for the first run


class LanguageModel:
    """A language model, loaded from the files of its card. Call `ask` from one thread at a time.

    Args:
        questions: questions with every answer that will ever be offered. The first run asks them.
        providers, threads, device_id: see `open_session`.

    Attributes:
        takes_images: True if it takes images, False if it takes text only.

    Raises:
        ModelError: a file is missing, damaged or not of the published layout, the files do not
            match, an answer has no token, or the first run fails.
    """

    def __init__(
        self,
        card: ChoiceCard,
        questions: Sequence[MultipleChoice],
        providers: Sequence[str] = ("CPUExecutionProvider",),
        threads: int = 2,
        device_id: int = 0,
    ) -> None:
        if TENSORRT_PROVIDERS.intersection(providers):
            raise ModelError(
                f"model {card.name}: has inputs without a fixed shape, which TensorRT needs: name "
                "CUDAExecutionProvider or CPUExecutionProvider in perception.choice.providers"
            )
        verify_parts(card, believe_cache=True)
        files = read_files(card)

        def open_part(part: Any) -> Any:
            path = card.path_of(part)
            engine = EngineOptions(path.stem, "fp32", section="perception.choice")
            return open_session(path, providers, threads, device_id, engine)

        self.name, self.takes_images = card.name, card.vision_encoder is not None
        self._card, self._deadline = card, InferenceTimeout(card.name)
        self._prompter = Prompter(files)
        self._ids = self._token_ids(
            {answer for question in questions for answer in question.answers}
        )
        self._vision: Any = None
        if self.takes_images:
            token = self._prompter.image_token
            self._prepare = make_prepare(files, token, card.image_tokens)
            self._vision = open_part(card.vision_encoder)
        embedding = open_part(card.embed_tokens) if card.embed_tokens is not None else None
        self._decoder = Decoder(files, open_part(card.decoder), embedding, self._deadline)
        # Token ids that are kept in the cache from one call to the next, and their cache.
        self._kept_ids, self._kept = np.empty(0, np.int64), self._decoder.nothing
        blank = np.zeros((_BLANK_PX, _BLANK_PX, 3), np.uint8)
        self.ask("Be brief.", blank if self.takes_images else "Nothing.", questions, FIRST_RUN_S)

    def _token_ids(self, answers: set[str]) -> dict[str, np.ndarray]:
        """Return the ids of each answer's tokens; raise ModelError if an answer has none."""
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
        self,
        rules: str,
        view: np.ndarray | str,
        questions: Sequence[MultipleChoice],
        limit_s: float,
    ) -> list[np.ndarray]:
        """Answer questions about one view.

        Args:
            rules: the system message.
            view: (h, w, 3) uint8 RGB for a model that takes images, else text.
            questions: the questions, at least one.
            limit_s: time limit of all questions together.

        Returns:
            For each question (n,) float32, the probability of each of its answers (ViTL eq. 4).

        Raises:
            ModelError: the model fails, takes too long, or returns values that are not finite.
        """
        with self._deadline.within(limit_s):
            return self._ask(rules, view, questions)

    def _ask(
        self, rules: str, view: np.ndarray | str, questions: Sequence[MultipleChoice]
    ) -> list[np.ndarray]:
        """Answer the questions without a time limit of its own; see `ask`."""
        prompter, words = self._prompter, view if isinstance(view, str) else None
        texts = [prompter.text(rules, words, choice.question) for choice in questions]
        features, grid = np.empty((0, 0), np.float32), None
        if words is None:
            picture = self._prepare(view)
            texts = [text.replace(prompter.image_token, picture.text) for text in texts]
            features, grid = self._image_features(picture.feeds), picture.grid
        ids = [prompter.ids(text) for text in texts]
        self._check_sizes(ids, features)
        shared = min(common_prefix(ids[0], other) for other in ids)
        shared = min(shared, *(len(row) - 1 for row in ids))  # the last token gives the logits
        past = self._read(ids[0][:shared], features, grid)
        answered = []
        for question_ids, choice in zip(ids, questions, strict=True):
            rows = self._decoder_input(question_ids, past.length, features)
            places = positions(question_ids, prompter.image_id, grid)[:, past.length :]
            logits = self._decoder.next_logits(rows, places, past)
            answered.append(self._probabilities(logits, choice.answers))
        return answered

    def _read(
        self, ids: np.ndarray, features: np.ndarray, grid: tuple[int, int, int] | None
    ) -> KeyValueCache:
        """Return the cache after `ids`.

        Tokens at the beginning that are those of the last call are not read again. The tokens of
        all images have the same id, so only tokens before an image are kept for the next call.
        """
        image_id = self._prompter.image_id
        images = np.flatnonzero(ids == image_id) if len(features) else ids[:0]
        keepable = int(images[0]) if len(images) else len(ids)
        known = min(common_prefix(self._kept_ids, ids), keepable)
        past = self._kept.first(known)
        if known < len(ids):
            rows = self._decoder_input(ids, known, features)
            past = self._decoder.read(rows, positions(ids, image_id, grid)[:, known:], past)
        if known < keepable:
            self._kept_ids, self._kept = ids[:keepable], past.first(keepable)
        return past

    def _decoder_input(self, ids: np.ndarray, begin: int, features: np.ndarray) -> np.ndarray:
        """Return the decoder's input from token `begin` on; image features replace image tokens."""
        rows = self._decoder.embed(ids[begin:])
        if len(features):
            is_image = ids == self._prompter.image_id
            n_before, to_replace = int(is_image[:begin].sum()), is_image[begin:]
            if to_replace.any():
                rows = rows.copy()
                rows[to_replace] = features[n_before : n_before + int(to_replace.sum())]
        return rows

    def _image_features(self, feeds: dict[str, np.ndarray]) -> np.ndarray:
        """Return the (n, d) features of an image: row i replaces the embedding of image token i."""
        inputs = {}
        for value in self._vision.get_inputs():
            if value.name not in feeds:
                raise ModelError(
                    f"model {self.name}: its vision encoder needs the input {value.name!r:.40}, "
                    f"but its image processor makes only {', '.join(feeds)}; take another model"
                )
            inputs[value.name] = feeds[value.name].astype(DTYPES[value.type], copy=False)
        names = [value.name for value in self._vision.get_outputs()]
        if lacking := sorted(set(self._decoder.deepstack) - set(names)):
            raise ModelError(
                f"model {self.name}: its vision encoder has no output {lacking[0]}, which its "
                "decoder needs: the files are of two models"
            )
        names = [names[0], *self._decoder.deepstack]
        found = self._vision.run(names, inputs, self._deadline.options)
        return np.concatenate([one.reshape(-1, one.shape[-1]) for one in found], axis=-1)

    def _check_sizes(self, ids: Sequence[np.ndarray], features: np.ndarray) -> None:
        """Raise ModelError if a question is too long, or image tokens and features do not match."""
        for question_ids in ids:
            if len(question_ids) > self._card.max_tokens:
                raise ModelError(
                    f"model {self.name}: a question has {len(question_ids)} tokens, but max_tokens "
                    f"of its card is {self._card.max_tokens}; raise max_tokens if the model can "
                    "read more, or take another model"
                )
            is_image = question_ids == self._prompter.image_id
            images = int(is_image.sum()) if len(features) else 0
            if images != len(features):
                raise ModelError(
                    f"model {self.name}: its vision encoder makes {len(features)} rows of an "
                    f"image, but its prompt has {images} image tokens: the files are of two models"
                )

    def _probabilities(self, logits: np.ndarray, answers: Sequence[str]) -> np.ndarray:
        """Return the probability of each answer, (n,) float32, from all logits; see `ask`."""
        ids = [self._ids[answer] for answer in answers]
        if max(int(tokens.max()) for tokens in ids) >= len(logits):
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
