"""How three ONNX files choose among the letters, compared with the model that they are made of.

What is compared is what the service reads (`scoring/choice`): of the logits behind a
picture and a question only the letters'.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from edge.host.bars import counted
from edge.perception.scoring.choice.question import LETTERS, SYSTEM, direction_question
from exporters import hugging_face
from exporters.encoder_parity import rank_agreement
from exporters.files import ExportError
from exporters.onnx_format import cpu_session
from exporters.reports import Report

TARGETS = ("chair", "refrigerator", "bed")
MARKS = 4
"""Directions that a question offers, and one letter more for elsewhere."""
_SPELLINGS = ("{}", "Ġ{}", "▁{}")
"""How vocabularies write a letter: alone, and behind a space."""


@dataclass(frozen=True)
class Question:
    """A question about a picture, as tokens.

    Attributes:
        before, after: of the picture's own tokens.
        letters: the tokens of the answers.
        image: the token that stands in a picture's places.
    """

    before: tuple[int, ...]
    after: tuple[int, ...]
    letters: tuple[int, ...]
    image: int

    def ids(self, tokens: int) -> np.ndarray:
        """(1, n) int64 with so many places for the picture."""
        return np.array([[*self.before, *[self.image] * tokens, *self.after]], np.int64)


def questions(folder: Path, image_token: int) -> list[Question]:
    """ViTL's directional question for a few targets, in a folder's tokens."""
    path = folder / hugging_face.TOKENIZER
    tokenizer = hugging_face.open_tokenizer(path)

    def ids(text: str) -> tuple[int, ...]:
        return tuple(tokenizer.encode(text, add_special_tokens=False).ids)

    letters = []
    for letter in LETTERS[: MARKS + 1]:
        found = [tokenizer.token_to_id(spelling.format(letter)) for spelling in _SPELLINGS]
        if not any(token is not None for token in found):
            raise ExportError(f"{path}: no token for {letter!r}: it cannot answer with one token")
        letters.append(next(token for token in found if token is not None))
    return [
        Question(ids(SYSTEM), ids(direction_question(MARKS, target)), tuple(letters), image_token)
        for target in TARGETS
    ]


def places_of(ids: np.ndarray, image: int, grid: np.ndarray | None, merge: int) -> np.ndarray:
    """Places of tokens, (1, n) int64, or with a grid (3, 1, n): time, row, column (Qwen2-VL 2.1).

    Args:
        grid: (1, 3) patches of the picture; `merge`² of them are a token.
    """
    n = ids.shape[1]
    if grid is None:
        return np.arange(n, dtype=np.int64)[None]
    time, rows, columns = (int(v) for v in grid[0])
    shape = (time, rows // merge, columns // merge)
    first = int(np.flatnonzero(ids[0] == image)[0])
    count = int(np.prod(shape))
    places = np.tile(np.arange(n, dtype=np.int64), (3, 1))
    places[:, first : first + count] = first + np.indices(shape).reshape(3, -1)
    places[:, first + count :] = np.arange(n - first - count) + first + max(shape)
    return places[:, None]


class Shown(NamedTuple):
    """A picture, as the original sees it.

    Attributes:
        feeds: of the vision encoder's ONNX.
        features: (tokens, d) float32.
    """

    feeds: dict[str, np.ndarray]
    features: np.ndarray

    @property
    def grid(self) -> np.ndarray | None:
        """(1, 3) of its patches, for a model whose places have three numbers."""
        return self.feeds.get("grid_thw", self.feeds.get("image_grid_thw"))


class Original(Protocol):
    """What a candidate is compared with: a model of `transformers`, or its files in FP32.

    Attributes:
        merge: how many patches a token is high and wide.
    """

    merge: int

    def logits(self, question: Question, shown: Shown) -> np.ndarray:
        """(v,) float32 of the token behind the question."""
        ...


class Chain:
    """Three ONNX files, one after the other, on the CPU."""

    def __init__(self, files: list[Path]) -> None:
        """
        Args:
            files: vision encoder, embedding of tokens, decoder.
        """
        self._vision, self._embedding, self._decoder = (cpu_session(f, threads=2) for f in files)

    @property
    def vision_inputs(self) -> list[str]:
        return [value.name for value in self._vision.get_inputs()]

    def features(self, feeds: dict[str, np.ndarray]) -> np.ndarray:
        """(tokens, d) of a prepared picture."""
        (found,) = self._vision.run(["image_features"], feeds)
        return found.reshape(-1, found.shape[-1])

    def rows(self, ids: np.ndarray, image: int, features: np.ndarray) -> np.ndarray:
        """(1, n, d): embeddings, with the picture's features in its places."""
        (rows,) = self._embedding.run(["inputs_embeds"], {"input_ids": ids})
        rows[ids == image] = features
        return rows

    def logits(
        self, question: Question, features: np.ndarray, grid: np.ndarray | None, merge: int
    ) -> np.ndarray:
        """(v,) of the token behind a question about a picture; see `places_of`."""
        ids = question.ids(len(features))
        places = places_of(ids, question.image, grid, merge)
        return self.read(self.rows(ids, question.image, features), places)[0]

    def read(
        self, rows: np.ndarray, places: np.ndarray, past: dict[str, np.ndarray] | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Read on; logits (v,) of the last token, and all that was read, for the next time."""
        past = self._nothing() if past is None else past
        logits, *present = self._decoder.run(None, self.decoder_feeds(rows, places, past))
        return logits[0, -1], dict(zip(past, present, strict=True))

    def decoder_feeds(
        self, rows: np.ndarray, places: np.ndarray, past: dict[str, np.ndarray] | None = None
    ) -> dict[str, np.ndarray]:
        """Inputs of the decoder that reads on."""
        past = self._nothing() if past is None else past
        before = next(iter(past.values())).shape[2]
        return {
            "inputs_embeds": rows,
            "attention_mask": np.ones((1, before + rows.shape[1]), np.int64),
            "position_ids": places,
            **past,
        }

    def _nothing(self) -> dict[str, np.ndarray]:
        types = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
        return {
            value.name: np.zeros((1, value.shape[1], 0, value.shape[3]), types[value.type])
            for value in self._decoder.get_inputs()
            if value.name.startswith("past_key_values.")
        }


@dataclass(frozen=True)
class LetterReport(Report):
    """What a candidate kept of the original's answers.

    Attributes:
        questions: number of pictures times targets.
        cosine: the lowest between two features of a picture.
        same_letter: share of the questions that both answer alike.
        rank_agreement: share of the pairs of letters in one order (`encoder_parity`).
        share_error: the largest difference of a letter's probability (ViTL eq. 4).
        max_abs_diff: the largest difference of a letter's logit.
    """

    questions: int
    cosine: float
    same_letter: float
    rank_agreement: float
    share_error: float
    max_abs_diff: float


class Exam:
    """Questions about pictures, and what the original answers: (letters, pictures · questions)."""

    def __init__(self, original: Original, pictures: list[Shown], asked: list[Question]) -> None:
        self._pictures, self._asked, self._merge = pictures, asked, original.merge
        rows = [
            original.logits(question, shown)[list(question.letters)]
            for shown in counted("pictures: the original is asked", pictures)
            for question in asked
        ]
        self._reference = np.array(rows).T

    def sit(self, chain: Chain) -> LetterReport:
        """Ask three files the same; raises ExportError if what they answer is not finite."""
        found, cosines = [], []
        for shown in counted("pictures: asked about", self._pictures):
            features = chain.features(shown.feeds)
            norms = np.linalg.norm(shown.features, axis=1) * np.linalg.norm(features, axis=1)
            cosines.append(float(((shown.features * features).sum(axis=1) / norms).min()))
            found += [
                chain.logits(question, features, shown.grid, self._merge)[list(question.letters)]
                for question in self._asked
            ]
        reference, candidate = self._reference, np.array(found, np.float32).T
        if not (np.isfinite(candidate).all() and np.isfinite(cosines).all()):
            raise ExportError("the candidate's logits or features are not finite; take more bits")
        return LetterReport(
            questions=reference.shape[1],
            cosine=min(cosines),
            same_letter=float((reference.argmax(axis=0) == candidate.argmax(axis=0)).mean()),
            rank_agreement=rank_agreement(reference, candidate),
            share_error=float(np.abs(_shares(reference) - _shares(candidate)).max()),
            max_abs_diff=float(np.abs(reference - candidate).max()),
        )


def _shares(logits: np.ndarray) -> np.ndarray:
    """Softmax over the letters, (letters, questions)."""
    powers = np.exp(logits - logits.max(axis=0))
    return powers / powers.sum(axis=0)
