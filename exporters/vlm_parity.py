"""Parity check of vision-language models: answers of three ONNX files compared with the original's.

The model answers a question about an image with a letter. Only the letters' probabilities
are compared, since the service reads no others (`edge/perception/scoring/choice`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from edge.host.progress import with_progress
from edge.perception.runtime.deadline import InferenceTimeout
from edge.perception.scoring.choice.question import LETTERS, SYSTEM, direction_question
from edge.perception.scoring.vlm.answers import answer_probabilities, answer_token_ids
from edge.perception.scoring.vlm.decoder import Decoder
from edge.perception.scoring.vlm.files import ModelFiles, vocabulary
from edge.perception.scoring.vlm.pictures import positions
from exporters import hugging_face
from exporters.encoder_parity import rank_agreement
from exporters.files import ExportError
from exporters.onnx_format import cpu_session
from exporters.reports import Report

TARGETS = ("chair", "refrigerator", "bed")
"""Targets of the questions."""
MARKS = 4
"""Directions that a question offers; one more letter stands for elsewhere."""


@dataclass(frozen=True)
class Question:
    """A question about an image, as tokens.

    Attributes:
        letters: tokens of each letter that may be the answer; see `answer_token_ids`.
    """

    before: tuple[int, ...]
    after: tuple[int, ...]
    letters: tuple[np.ndarray, ...]
    image: int

    def ids(self, tokens: int) -> np.ndarray:
        """Return (n,) int64 with `tokens` placeholders for the image."""
        return np.array([*self.before, *[self.image] * tokens, *self.after], np.int64)


def questions(folder: Path, image_token: int) -> list[Question]:
    """Return ViTL's directional question for a few targets, in the tokens of a folder."""
    path = folder / hugging_face.TOKENIZER
    tokenizer = hugging_face.open_tokenizer(path)

    def ids(text: str) -> tuple[int, ...]:
        return tuple(tokenizer.encode(text, add_special_tokens=False).ids)

    offered = LETTERS[: MARKS + 1]
    letters = tuple(answer_token_ids(vocabulary(tokenizer), offered))
    for letter, found in zip(offered, letters, strict=True):
        if not len(found):
            raise ExportError(
                f"{path}: has no token for the letter {letter!r}, so the model cannot answer with "
                "a letter; give another model"
            )
    return [
        Question(ids(SYSTEM), ids(direction_question(MARKS, target)), letters, image_token)
        for target in TARGETS
    ]


class EncodedImage(NamedTuple):
    """An image, encoded by the original.

    Attributes:
        feeds: inputs of the vision encoder's ONNX file, by name.
        features: (tokens, d) float32, a row for each placeholder of the image.
        grid: see `edge.perception.scoring.vlm.pictures.PreparedImage`.
    """

    feeds: dict[str, np.ndarray]
    features: np.ndarray
    grid: tuple[int, int, int] | None


class ReferenceModel(Protocol):
    """Reference of a comparison: a model of `transformers`, or its FP32 files."""

    def logits(self, question: Question, shown: EncodedImage) -> np.ndarray:
        """Return logits (v,) float32 of the token after the question; v tokens exist."""
        ...


class OnnxPipeline:
    """The three ONNX files of a model on the CPU; the service's own code runs the decoder."""

    def __init__(self, files: list[Path]) -> None:
        self._vision, embedding, decoder = (cpu_session(file, threads=2) for file in files)
        # The decoder declares the shape of its cache, so that it needs no configuration.
        model = ModelFiles(files[2].stem, files[2].parent, {}, None, {}, {}, "")
        self._decoder = Decoder(model, decoder, embedding, InferenceTimeout(model.name))

    @property
    def vision_inputs(self) -> list[str]:
        """Names of the vision encoder's inputs."""
        return [value.name for value in self._vision.get_inputs()]

    def features(self, feeds: dict[str, np.ndarray]) -> np.ndarray:
        """Return (tokens, d) of a preprocessed image; DeepStack's arrays are next to each other."""
        found = self._vision.run(None, feeds)
        return np.concatenate([one.reshape(-1, one.shape[-1]) for one in found], axis=-1)

    def logits(
        self, question: Question, features: np.ndarray, grid: tuple[int, int, int] | None
    ) -> np.ndarray:
        """Return logits (v,) of the token after a question about an image; see `EncodedImage`."""
        ids = question.ids(len(features))
        rows = self._decoder.embed(ids)
        rows[ids == question.image] = features
        places = positions(ids, question.image, grid)
        return self._decoder.next_logits(rows, places, self._decoder.nothing)


@dataclass(frozen=True)
class LetterReport(Report):
    """Agreement of a candidate's answers with the original's.

    Attributes:
        questions: number of images times targets.
        cosine: lowest cosine between a feature of an image and the original's.
        rank_agreement: share of the pairs of letters in the same order (`encoder_parity`).
        share_error: largest difference of a letter's probability (ViTL eq. 4).
    """

    questions: int
    cosine: float
    rank_agreement: float
    share_error: float


class LetterComparison:
    """Questions about images with the original's answers, to compare candidates with."""

    def __init__(
        self, original: ReferenceModel, pictures: list[EncodedImage], asked: list[Question]
    ) -> None:
        self._pictures, self._asked = pictures, asked
        rows = [
            answer_probabilities(original.logits(question, shown), question.letters)
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
                answer_probabilities(
                    pipeline.logits(question, features, shown.grid), question.letters
                )
                for question in self._asked
            ]
        reference, candidate = self._reference, np.array(found).T
        if not (np.isfinite(candidate).all() and np.isfinite(cosines).all()):
            raise ExportError(
                "the new model's logits or features are not finite; choose a --precision with "
                "more bits"
            )
        return LetterReport(
            questions=reference.shape[1],
            cosine=min(cosines),
            rank_agreement=rank_agreement(reference, candidate),
            share_error=float(np.abs(reference - candidate).max()),
        )
