"""Benchmark: time that cached prompt prefixes save a model that chooses directions."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import onnxruntime as ort

from edge.host import resources
from edge.perception.scoring.choice.letter_scorer import both_questions
from edge.perception.scoring.choice.question import (
    SYSTEM,
    DetectedObject,
    Mark,
    MarkedView,
    describe,
)
from edge.perception.scoring.vlm.model import LanguageModel
from edge.types import Observation

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from tiny_vlm import Size, publish

LIMIT_S = 600.0
SIZE = Size(hidden=256, heads=4, layers=8)


def view(k: int) -> str:
    """Return the description of view number `k` in words; each number gives another one."""
    seen = tuple(DetectedObject(f"thing {k + i}", 0.1 * i, 1.0 + i) for i in range(8))
    marks = tuple(Mark(i, 0.0, 0.0, 0.3 * i, 2.0 + i) for i in range(4))
    return describe(MarkedView(Observation(0, 0, np.eye(4)), "chair", marks, seen))


def test_two_questions_against_two_prefills(benchmark, against, tmp_path, monkeypatch):
    """Compare both questions about a new view with two full prefills, in processor time.

    The reference reads both questions completely, in its own session without a cache.
    """
    benchmark.extra_info["budget"] = "choice_two_questions"
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir(parents=True)
    card = publish(resources.models_dir(), "text", size=SIZE)
    questions, views = both_questions(4, "chair"), iter(range(1 << 30))
    model = LanguageModel(card, both_questions(8, "chair"), threads=1)
    found = benchmark.pedantic(
        lambda: model.ask(SYSTEM, view(next(views)), questions, LIMIT_S), rounds=15, warmup_rounds=2
    )
    assert found[0].sum() > 0.99

    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(str(card.path_of(card.decoder)), options)
    nothing = model._decoder.nothing.arrays

    def read_whole() -> None:
        words = view(next(views))
        for asked in questions:
            ids = model._prompter.ids(model._prompter.text(SYSTEM, words, asked.question))
            places = np.arange(len(ids))[None]
            feeds = {"input_ids": ids[None], "attention_mask": np.ones_like(places)}
            session.run(["logits"], {**feeds, "position_ids": places, **nothing})

    against(read_whole)
