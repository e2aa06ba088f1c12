"""Benchmark: translation of an instruction to a formula, by grammar, small model and both."""

from __future__ import annotations

import pytest

from edge.config import TranslatorAuto, TranslatorGrammar, TranslatorModel
from edge.mission.translate import make_translator

# The grammar understands the first sentence, and refuses the second.
PLAIN = "go to the kitchen, then go through the hallway to the bedroom, but avoid the sofa"
OTHER = "you can go anywhere except the red room as long as you get to the purple room"

CASES = {
    "translate_grammar": (TranslatorGrammar(), PLAIN),
    "translate_model": (TranslatorModel(), PLAIN),
    "translate_auto": (TranslatorAuto(), OTHER),
}


@pytest.mark.parametrize("name", CASES)
def test_translate(benchmark, name):
    benchmark.extra_info["budget"] = name
    config, instruction = CASES[name]
    read = make_translator(config).read
    assert benchmark(read, instruction).formulas
