"""How three ONNX files choose among the letters, compared with the model that they are made of.

What is compared is what the service reads (`edge.perception.choice`): of the logits behind a
picture and a question only the letters'.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn

from edge.host.bars import counted
from edge.perception.choice.question import LETTERS, SYSTEM, direction_question
from exporters import hugging_face
from exporters.encoder_parity import rank_agreement
from exporters.files import ExportError
from exporters.onnx_format import cpu_session

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
        return self.feeds.get("grid_thw")


class Original:
    """The model of `transformers`, asked as a whole.

    Attributes:
        prepare: (h, w, 3) uint8 → inputs of the vision encoder's ONNX.
        merge: how many patches a token is high and wide.
    """

    def __init__(self, model: nn.Module, prepare: Callable[[np.ndarray], dict]) -> None:
        self._model, self.prepare = model, prepare
        visual = getattr(model.model, "visual", None)
        self.merge = 1 if visual is None else visual.spatial_merge_size

    def show(self, rgb: np.ndarray) -> Shown:
        """A picture, (h, w, 3) uint8, made ready and looked at."""
        feeds = self.prepare(rgb)
        with torch.inference_mode():
            found = self._model.model.get_image_features(**_inputs(feeds)).pooler_output
        rows = found if torch.is_tensor(found) else torch.cat(tuple(found))
        return Shown(feeds, rows.reshape(-1, rows.shape[-1]).numpy())

    def logits(self, question: Question, shown: Shown) -> np.ndarray:
        """(v,) float32 of the token behind the question."""
        ids = torch.from_numpy(question.ids(len(shown.features)))
        more = {}
        if shown.grid is not None:
            more["mm_token_type_ids"] = (ids == question.image).to(torch.int32)
        with torch.inference_mode():
            found = self._model(
                input_ids=ids, attention_mask=torch.ones_like(ids), **_inputs(shown.feeds), **more
            )
        return found.logits[0, -1].numpy()

    def decoder_feeds(self, question: Question, shown: Shown) -> dict[str, np.ndarray]:
        """Inputs of the decoder's ONNX for the whole question, with nothing before it."""
        ids = question.ids(len(shown.features))
        with torch.inference_mode():
            rows = self._model.get_input_embeddings()(torch.from_numpy(ids)).numpy().copy()
        rows[ids == question.image] = shown.features
        heads, size = cache_shape(self._model.config.get_text_config())
        layers = self._model.config.get_text_config().num_hidden_layers
        empty = np.zeros((1, heads, 0, size), np.float32)
        return {
            "inputs_embeds": rows,
            "attention_mask": np.ones(ids.shape, np.int64),
            "position_ids": places_of(ids, question.image, shown.grid, self.merge),
            **{
                f"past_key_values.{layer}.{kind}": empty
                for layer in range(layers)
                for kind in ("key", "value")
            },
        }


def cache_shape(text: Any) -> tuple[int, int]:
    """(heads, size) of a language model's keys and values, by its configuration."""
    size = getattr(text, "head_dim", None) or text.hidden_size // text.num_attention_heads
    return text.num_key_value_heads, size


def _inputs(feeds: dict[str, np.ndarray]) -> dict[str, Any]:
    """Of the vision encoder's ONNX → those of transformers, which calls the grid otherwise."""
    renamed = {"grid_thw": "image_grid_thw"}
    return {renamed.get(key, key): torch.from_numpy(value) for key, value in feeds.items()}


class Chain:
    """Three ONNX files, one after the other, on the CPU."""

    def __init__(self, files: list[Path]) -> None:
        """
        Args:
            files: vision encoder, embedding of tokens, decoder.
        """
        self._vision, self._embedding, self._decoder = (cpu_session(f, threads=2) for f in files)

    def features(self, feeds: dict[str, np.ndarray]) -> np.ndarray:
        """(tokens, d) of a prepared picture."""
        (found,) = self._vision.run(["image_features"], feeds)
        return found.reshape(-1, found.shape[-1])

    def rows(self, ids: np.ndarray, image: int, features: np.ndarray) -> np.ndarray:
        """(1, n, d): embeddings, with the picture's features in its places."""
        (rows,) = self._embedding.run(["inputs_embeds"], {"input_ids": ids})
        rows[ids == image] = features
        return rows

    def read(
        self, rows: np.ndarray, places: np.ndarray, past: dict[str, np.ndarray] | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Read on; logits (v,) of the last token, and all that was read, for the next time."""
        past = self._nothing() if past is None else past
        before = next(iter(past.values())).shape[2]
        feeds = {
            "inputs_embeds": rows,
            "attention_mask": np.ones((1, before + rows.shape[1]), np.int64),
            "position_ids": places,
            **past,
        }
        logits, *present = self._decoder.run(None, feeds)
        return logits[0, -1], dict(zip(past, present, strict=True))

    def _nothing(self) -> dict[str, np.ndarray]:
        types = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
        return {
            value.name: np.zeros((1, value.shape[1], 0, value.shape[3]), types[value.type])
            for value in self._decoder.get_inputs()
            if value.name.startswith("past_key_values.")
        }


@dataclass(frozen=True)
class LetterReport:
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

    def figures(self) -> dict[str, float | int]:
        """Rounded, for a card and for `FILE.json`."""
        return {k: v if isinstance(v, int) else float(f"{v:.6g}") for k, v in asdict(self).items()}

    def table(self) -> str:
        """One readable line per figure."""
        return "\n".join(f"  {name:<16}{value:>12.6g}" for name, value in self.figures().items())


def letter_logits(original: Original, pictures: list[Shown], asked: list[Question]) -> np.ndarray:
    """What the original answers: (letters, pictures · questions) float32."""
    rows = [
        original.logits(question, shown)[list(question.letters)]
        for shown in counted("pictures: the original is asked", pictures)
        for question in asked
    ]
    return np.array(rows).T


def measure(
    reference: np.ndarray,
    chain: Chain,
    pictures: list[Shown],
    asked: list[Question],
    merge: int,
) -> LetterReport:
    """Ask the three files the same.

    Args:
        reference: see `letter_logits`.
        merge: see `Original`.

    Raises:
        ExportError: a logit or a feature is not finite.
    """
    found, cosines = [], []
    for shown in counted("pictures: asked about", pictures):
        features = chain.features(shown.feeds)
        norms = np.linalg.norm(shown.features, axis=1) * np.linalg.norm(features, axis=1)
        cosines.append(float(((shown.features * features).sum(axis=1) / norms).min()))
        for question in asked:
            ids = question.ids(len(features))
            places = places_of(ids, question.image, shown.grid, merge)
            logits, _ = chain.read(chain.rows(ids, question.image, features), places)
            found.append(logits[list(question.letters)])
    candidate = np.array(found, np.float32).T
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
