"""The small translator trained for a moment, and the file that comes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest
import yaml

torch = pytest.importorskip("torch")

from edge.lab.eval.translation_cases import TranslationCase  # noqa: E402
from edge.mission.language.grammar.prefix_notation import NAMES  # noqa: E402
from edge.mission.language.networks.network import TranslationNetwork  # noqa: E402
from edge.mission.logic.ltl import parse  # noqa: E402
from edge.perception.runtime.cards import read_card  # noqa: E402
from edge.perception.runtime.onnx_file import check_file  # noqa: E402
from exporters.files import ExportError  # noqa: E402
from exporters.training.translator.__main__ import NAME, main  # noqa: E402
from exporters.training.translator.compose import Composer, Pair, load  # noqa: E402
from exporters.training.translator.data import (  # noqa: E402
    UNKNOWN,
    Batcher,
    Source,
    extended,
    human_pairs,
    vocabulary_of,
)
from exporters.training.translator.export import export, parity  # noqa: E402
from exporters.training.translator.training import COMPOSED, train  # noqa: E402

pytestmark = pytest.mark.export
PHRASES = load()
WORDS = vocabulary_of(PHRASES, 0)
PLAN = replace(COMPOSED, steps=4, pairs=4, keep_every=2)


def test_human_sentences_become_training_pairs() -> None:
    cases = [
        TranslationCase("", "go to b by a", parse("F (a & F b)")),
        TranslationCase("", "never visit c until a", parse("!c U a")),
        TranslationCase("", "visit a twice", parse("F (a & F (!a & F a))")),
        TranslationCase("", "go to b", parse("F a")),  # names another object
        TranslationCase("", "visit a \x1b", parse("F a")),
        TranslationCase("", "dance a", parse("a U X X X a")),  # no family means this
    ]  # fmt: skip
    assert human_pairs(cases, PHRASES) == [
        Pair(("go", "to", "<0>", "by", "<1>"), ("F", "&", "<1>", "F", "<0>")),
        Pair(("never", "visit", "<0>", "until", "<1>"), ("W", "!", "<0>", "<1>")),
        Pair(("visit", "<0>", "twice"), (">=2", "<0>")),
    ]


def test_vocabularies_grow_at_their_end() -> None:
    pairs = [Pair(("zig", "<0>"), ("F", "<0>"))] * 4 + [Pair(("zag", "<0>"), ("F", "<0>"))]
    grown = extended(WORDS, pairs)
    assert grown.tokens == (*WORDS.tokens, "zig")
    (words, _), _ = Batcher(grown, 0.0).tensors(pairs[-1:], Random(0))
    assert words.tolist()[0][0] == grown.tokens.index(UNKNOWN)


def test_refused_pairs_are_trained_in_one_direction_only() -> None:
    rng = Random(0)
    batcher = Batcher(WORDS)
    batch = next(batcher.batches(Source(Composer(PHRASES, rng), [], 0.0, rng), 64))
    (words, formulas), (sources, sentences) = batcher.tensors(batch, rng)
    assert len(words) == len(formulas) == len(batch)
    assert len(sources) == len(sentences) < len(batch)


def test_training_continues_and_its_file_gives_the_same_results(tmp_path: Path) -> None:
    whole = train(PHRASES, [], WORDS, PLAN, tmp_path / "whole.pt")
    train(PHRASES, [], WORDS, PLAN, tmp_path / "again.pt")
    assert parity_of(whole, tmp_path) < 0.05
    with pytest.raises(ExportError, match="of another run"):
        train(PHRASES, [], WORDS, replace(PLAN, pairs=8), tmp_path / "whole.pt")


def parity_of(net: object, folder: Path) -> float:
    path = folder / "translator.onnx"
    off = export(net, WORDS, path)
    assert off == pytest.approx(parity(net, path), abs=0.05)
    network = TranslationNetwork.from_file(path)
    assert network.tokens == WORDS.tokens
    written = network.formulas(("go", "to", "<0>"), 1)
    assert np.exp([one.log_p for one in written]).sum() <= 1.0 + 1e-6
    assert np.isfinite(network.back_translation_log_p(("F", NAMES[0]), [("go", "to", "<0>")]))
    return off


def test_the_command_leaves_a_file_and_its_card(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "table.csv"
    table.write_text("pattern_type,props,utterance,ltl_formula\nvisit,['a'],visit a,F a\n")
    words = ["--out", tmp_path / "run", "--models", tmp_path, "--lang2ltl", table]
    words += ["--steps", "2", "--people-steps", "2"]
    assert main([*map(str, words)]) == 0
    card = read_card(tmp_path / f"{NAME}.yaml")
    assert card.measured["training"]["lang2ltl_sentences"] == 1
    assert sum(card.measured["lang2ltl, not seen, model"].values()) == 1
    check_file(tmp_path / f"{NAME}.onnx", card)
    assert yaml.safe_load(capsys.readouterr().out) == card.measured
    with pytest.raises(SystemExit):
        main(["--out", str(tmp_path), "--steps", "0"])
    assert "--steps: expected an integer from 1, got 0" in capsys.readouterr().err
