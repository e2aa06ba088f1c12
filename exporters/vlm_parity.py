"""Parity check of vision-language models: answers of three ONNX files compared with the original's.

The model answers a question about an image with a letter. Only the logits of the letters are
compared, since the service reads no others (`edge/perception/scoring/choice`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from edge.host.progress import with_progress
from edge.perception.scoring.choice.question import LETTERS, SYSTEM, direction_question
from edge.perception.scoring.vlm.decoder import DEEPSTACK
from exporters import hugging_face
from exporters.encoder_parity import rank_agreement
from exporters.files import ExportError
from exporters.onnx_format import cpu_session
from exporters.reports import Report

TARGETS = ("chair", "refrigerator", "bed")
"""Targets of the questions."""
MARKS = 4
"""Directions that a question offers; one more letter stands for elsewhere."""
_SPELLINGS = ("{}", "Ġ{}", "▁{}")
"""Spellings of a letter in vocabularies: alone, or after a space."""


@dataclass(frozen=True)
class Question:
    """A question about an image, as tokens.

    Attributes:
        letters: token of each letter that may be the answer.
    """

    before: tuple[int, ...]
    after: tuple[int, ...]
    letters: tuple[int, ...]
    image: int

    def ids(self, tokens: int) -> np.ndarray:
        """Return (1, n) int64 with `tokens` placeholders for the image."""
        return np.array([[*self.before, *[self.image] * tokens, *self.after]], np.int64)


def questions(folder: Path, image_token: int) -> list[Question]:
    """Return ViTL's directional question for a few targets, in the tokens of a folder."""
    path = folder / hugging_face.TOKENIZER
    tokenizer = hugging_face.open_tokenizer(path)

    def ids(text: str) -> tuple[int, ...]:
        return tuple(tokenizer.encode(text, add_special_tokens=False).ids)

    letters = []
    for letter in LETTERS[: MARKS + 1]:
        found = [tokenizer.token_to_id(spelling.format(letter)) for spelling in _SPELLINGS]
        if not any(token is not None for token in found):
            raise ExportError(
                f"{path}: has no token for the letter {letter!r}, so the model cannot answer with "
                "a letter; give another model"
            )
        letters.append(next(token for token in found if token is not None))
    return [
        Question(ids(SYSTEM), ids(direction_question(MARKS, target)), tuple(letters), image_token)
        for target in TARGETS
    ]


def position_ids_of(ids: np.ndarray, image: int, grid: np.ndarray | None, merge: int) -> np.ndarray:
    """Return the position ids of tokens (1, n), (1, n) int64; with a grid (3, 1, n).

    With a grid, each token has three numbers (Qwen2-VL section 2.1): time, row and column. The grid
    is (1, 3): frames, rows and columns of patches of the image, whose placeholder token is `image`.
    `merge` is that of `ReferenceModel`.
    """
    n = ids.shape[1]
    if grid is None:
        return np.arange(n, dtype=np.int64)[None]
    time, rows, columns = (int(v) for v in grid[0])
    shape = (time, rows // merge, columns // merge)
    first = int(np.flatnonzero(ids[0] == image)[0])
    count = int(np.prod(shape))
    positions = np.tile(np.arange(n, dtype=np.int64), (3, 1))
    # The image's tokens: all three numbers count from `first`.
    positions[:, first : first + count] = first + np.indices(shape).reshape(3, -1)
    # The text goes on after the largest number of the image.
    positions[:, first + count :] = np.arange(n - first - count) + first + max(shape)
    return positions[:, None]


class EncodedImage(NamedTuple):
    """An image, encoded by the original.

    Attributes:
        feeds: inputs of the vision encoder's ONNX file, by name.
        features: (tokens, d) float32, a row for each placeholder of the image.
    """

    feeds: dict[str, np.ndarray]
    features: np.ndarray

    @property
    def grid(self) -> np.ndarray | None:
        """See `position_ids_of`; None for a model with plain positions."""
        return self.feeds.get("grid_thw", self.feeds.get("image_grid_thw"))


class ReferenceModel(Protocol):
    """Reference of a comparison: a model of `transformers`, or its FP32 files.

    Attributes:
        merge: side, in patches, of the square of the image that one token stands for.
    """

    merge: int

    def logits(self, question: Question, shown: EncodedImage) -> np.ndarray:
        """Return logits (v,) float32 of the token after the question; v tokens exist."""
        ...


class OnnxPipeline:
    """The three ONNX files of a model, run one after another on the CPU."""

    def __init__(self, files: list[Path]) -> None:
        self._vision, self._embedding, self._decoder = (cpu_session(f, threads=2) for f in files)

    @property
    def vision_inputs(self) -> list[str]:
        """Names of the vision encoder's inputs."""
        return [value.name for value in self._vision.get_inputs()]

    def features(self, feeds: dict[str, np.ndarray]) -> np.ndarray:
        """Return (tokens, d) of a preprocessed image; DeepStack's arrays are next to each other."""
        found = self._vision.run(None, feeds)
        return np.concatenate([one.reshape(-1, one.shape[-1]) for one in found], axis=-1)

    def rows(self, ids: np.ndarray, image: int, features: np.ndarray) -> np.ndarray:
        """Return (1, n, d): embeddings, with the image's features in its placeholders.

        With DeepStack, the rows of text end with zeros.
        """
        (rows,) = self._embedding.run(["inputs_embeds"], {"input_ids": ids})
        rows = np.pad(rows, ((0, 0), (0, 0), (0, features.shape[-1] - rows.shape[-1])))
        rows[ids == image] = features
        return rows

    def logits(
        self, question: Question, features: np.ndarray, grid: np.ndarray | None, merge: int
    ) -> np.ndarray:
        """Return logits (v,) of the token after a question; see `position_ids_of`."""
        ids = question.ids(len(features))
        positions = position_ids_of(ids, question.image, grid, merge)
        return self.read(self.rows(ids, question.image, features), positions)[0]

    def read(
        self, rows: np.ndarray, positions: np.ndarray, past: dict[str, np.ndarray] | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Read more tokens; return logits (v,) after the last token, and `past` of the next call.

        Args:
            rows: see `rows`.
            positions: see `position_ids_of`.
            past: keys and values of the tokens so far; None if there are none.
        """
        past = self._empty_cache() if past is None else past
        logits, *present = self._decoder.run(None, self.decoder_feeds(rows, positions, past))
        return logits[0, -1], dict(zip(past, present, strict=True))

    def decoder_feeds(
        self, rows: np.ndarray, positions: np.ndarray, past: dict[str, np.ndarray] | None = None
    ) -> dict[str, np.ndarray]:
        """Return the decoder's inputs for more tokens; for the arguments see `read`."""
        past = self._empty_cache() if past is None else past
        before = next(iter(past.values())).shape[2]  # number of tokens so far
        names = [value.name for value in self._decoder.get_inputs()]
        names = ["inputs_embeds", *(name for name in names if name.startswith(DEEPSTACK))]
        return {
            **dict(zip(names, np.split(rows, len(names), axis=-1), strict=True)),
            "attention_mask": np.ones((1, before + rows.shape[1]), np.int64),
            "position_ids": positions,
            **past,
        }

    def _empty_cache(self) -> dict[str, np.ndarray]:
        """Return keys and values of no tokens, by the name of the decoder's input."""
        types = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
        return {
            value.name: np.zeros((1, value.shape[1], 0, value.shape[3]), types[value.type])
            for value in self._decoder.get_inputs()
            if value.name.startswith("past_key_values.")
        }


@dataclass(frozen=True)
class LetterReport(Report):
    """Agreement of a candidate's answers with the original's.

    Attributes:
        questions: number of images times targets.
        cosine: lowest cosine between a feature of an image and the original's.
        same_letter: share of questions with the same answer.
        rank_agreement: share of the pairs of letters in the same order (`encoder_parity`).
        share_error: largest difference of a letter's probability (ViTL eq. 4).
        max_abs_diff: largest difference of a letter's logit.
    """

    questions: int
    cosine: float
    same_letter: float
    rank_agreement: float
    share_error: float
    max_abs_diff: float


class LetterComparison:
    """Questions about images with the original's answers, to compare candidates with."""

    def __init__(
        self, original: ReferenceModel, pictures: list[EncodedImage], asked: list[Question]
    ) -> None:
        self._pictures, self._asked, self._merge = pictures, asked, original.merge
        rows = [
            original.logits(question, shown)[list(question.letters)]
            for shown in with_progress("pictures: original", pictures)
            for question in asked
        ]
        self._reference = np.array(rows).T  # (letters, questions)

    def compare(self, pipeline: OnnxPipeline) -> LetterReport:
        """Ask three files the same questions; raise ExportError if an answer is not finite."""
        found, cosines = [], []
        for shown in with_progress("pictures: candidate", self._pictures):
            features = pipeline.features(shown.feeds)
            norms = np.linalg.norm(shown.features, axis=1) * np.linalg.norm(features, axis=1)
            cosines.append(float(((shown.features * features).sum(axis=1) / norms).min()))
            found += [
                pipeline.logits(question, features, shown.grid, self._merge)[list(question.letters)]
                for question in self._asked
            ]
        reference, candidate = self._reference, np.array(found, np.float32).T
        if not (np.isfinite(candidate).all() and np.isfinite(cosines).all()):
            raise ExportError(
                "the new model's logits or features are not finite; choose a --precision with "
                "more bits"
            )
        return LetterReport(
            questions=reference.shape[1],
            cosine=min(cosines),
            same_letter=float((reference.argmax(axis=0) == candidate.argmax(axis=0)).mean()),
            rank_agreement=rank_agreement(reference, candidate),
            share_error=float(np.abs(_shares(reference) - _shares(candidate)).max()),
            max_abs_diff=float(np.abs(reference - candidate).max()),
        )


def _shares(logits: np.ndarray) -> np.ndarray:
    """Return the softmax over the letters, (letters, questions)."""
    powers = np.exp(logits - logits.max(axis=0))
    return powers / powers.sum(axis=0)
