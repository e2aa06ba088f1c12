"""The `llm` backend against a real HTTP server with answers like a model's."""

from __future__ import annotations

import contextlib
import re
from types import SimpleNamespace

import pytest
from chat_server import completion, saying, send, serving
from hypothesis import given
from hypothesis import strategies as st

from edge.chat import ChatError
from edge.config import TranslatorLlm
from edge.errors import UserError
from edge.mission.language.networks import llm
from edge.mission.language.networks.llm import (
    MOST_NESTING,
    MOST_OPERANDS,
    SPARE,
    conversation,
    formula_in,
    gbnf,
    objects_in,
)
from edge.mission.logic.ltl import parse, propositions
from edge.mission.translate import TranslationError, make_translator

INSTRUCTION = "Clean the couch, then turn on the TV; don't go to the bed before that."


def translate(url: str, instruction: str = INSTRUCTION, **config):
    return make_translator(TranslatorLlm(url=url, **config)).translate(instruction)


@pytest.mark.parametrize(
    "answer",
    [
        "F (couch & F tv) & !bed W tv",
        'F (sofa & F "television") & (!bed W "TV set")',
        "```\nF (couch & F tv) & !bed W tv\n```",
        "```ltl\nLTL: F (couch & F tv) & !bed W tv\n```",
        "Formula: `◇(couch ∧ ◇tv) ∧ (¬bed W tv)`",
        "<think>F (bed & couch)?</think>\n\nF (couch & F tv) & !bed W tv\n",
    ],
)
def test_answers_that_are_understood(answer):
    with serving(saying(answer)) as server:
        result = translate(server.url)
    assert result.formula == parse("F (sofa & F television) & !bed W television")
    assert (result.instruction, result.backend, len(server.requests)) == (INSTRUCTION, "llm", 1)
    assert "television" in result.english
    assert result.seconds > 0


@pytest.mark.parametrize(
    ("first", "fault"),
    [
        ("F (couch & F tv", "formula, column 16: expected ')'"),
        ("The formula is F couch.", "formula, column 5: "),
        ("I can't do that.", "formula, column 3: "),
        ("F (couch & F lamp)", "the instruction names no 'table lamp'; it names couch, tv, bed"),
        ('F "the"', "'the'"),
        ('F "..."', "formula, column 3: '...' is no name"),
        ("true", "the formula names no object"),
        ("X " * 3000 + "tv", "it must be one formula"),
    ],
)
def test_a_wrong_answer_is_sent_back_once(first, fault):
    with serving(saying(first, "F (couch & F tv) & !bed W tv")) as server:
        result = translate(server.url)
    assert result.formula == parse("F (sofa & F television) & !bed W television")
    assert len(server.requests) == 2
    *before, wrong, wanted = server.requests[1][2]["messages"]
    assert before == server.requests[0][2]["messages"]
    assert wrong == {"role": "assistant", "content": first[:500]}
    assert fault in wanted["content"]

    with serving(saying(first)) as server:
        with pytest.raises(TranslationError) as raised:
            translate(server.url)
        assert len(server.requests) == 2
    assert server.url in str(raised.value)
    assert fault in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_cut_off_answer_is_not_a_formula():
    """`F couch` might be all that is left of `F couch & G !bed`."""
    answers = [completion("F couch", "length"), completion("F couch & G !bed")]
    with serving(lambda handler: send(handler, answers.pop(0))) as server:
        result = translate(server.url)
    assert (str(result.formula), len(server.requests)) == ("F sofa & G !bed", 2)


@pytest.mark.parametrize("instruction", ["Do not do that!", "...", "go there, then stop", "😀"])
def test_an_instruction_without_objects_sends_no_request(instruction):
    with serving(saying("F chair")) as server:
        with pytest.raises(TranslationError, match="names no object to reach"):
            translate(server.url, instruction)
        assert server.requests == []


def test_a_server_that_fails_is_not_asked_again():
    with serving(lambda handler: send(handler, b"", 500)) as server:
        with pytest.raises(ChatError, match=f"^{server.url}: the server answered HTTP 500"):
            translate(server.url)
        assert len(server.requests) == 1


def test_both_attempts_share_one_time_limit(monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(llm, "time", SimpleNamespace(monotonic=lambda: now_s[0]))

    def behave(handler):
        now_s[0] += 31.0
        send(handler, completion("nonsense ("))

    with serving(behave) as server:
        with pytest.raises(ChatError, match="no complete answer within 30 s; raise time_limit_s"):
            translate(server.url, time_limit_s=30.0)
        assert len(server.requests) == 1  # nothing is left for the second


@pytest.mark.parametrize("constrain", ["none", "gbnf", "guided_grammar"])
def test_the_request_holds_conversation_and_grammar(constrain):
    with serving(saying("F couch & !bed W tv")) as server:
        translate(server.url, constrain=constrain, model="tiny")
    request = server.requests[0][2]
    assert (request["model"], request["temperature"]) == ("tiny", 0)
    assert request["messages"] == conversation(INSTRUCTION)
    grammar = gbnf(objects_in(INSTRUCTION))
    assert request.get("grammar") == (grammar if constrain == "gbnf" else None)
    structured = {"grammar": grammar} if constrain == "guided_grammar" else None
    assert request.get("structured_outputs") == structured
    assert ("max_tokens" in request) == (constrain != "none")


@given(st.text(max_size=60))
def test_any_answer_is_a_formula_or_a_user_error(answer):
    with contextlib.suppress(UserError):
        assert set(propositions(formula_in(answer, ("chair", "bed")))) <= {"chair", "bed"}


@pytest.mark.parametrize(
    ("instruction", "objects"),
    [
        ("", ()),
        ("Never ever!", ()),
        (INSTRUCTION, ("couch", "tv", "bed")),
        ("the COFFEE tables and two chairs", ("coffee tables", "chairs")),
        ("the bed, table and lamp", ("bed", "table", "lamp")),
        ("the red chair", ("chair", "red chair")),
        ("the fire hydrant", ("fire hydrant",)),
        ("geh zum Stuhl", ("geh", "geh zum", "geh zum stuhl", "zum", "zum stuhl", "stuhl")),
        ("bed, bed; bed", ("bed",)),
    ],
)
def test_objects_of_an_instruction(instruction, objects):
    assert objects_in(instruction) == objects


@pytest.mark.parametrize("n", [1, 6, 12, 1000])
def test_the_grammar_is_bounded(n):
    rules = dict(line.split(" ::= ") for line in gbnf([f"n{i}" for i in range(n)]).splitlines())
    nesting = min(n + SPARE, MOST_NESTING)
    assert [rule for rule in rules if rule.startswith("both")] == [
        f"both{k}" for k in range(1, nesting + 1)
    ]
    assert f"{{1,{min(n + SPARE, MOST_OPERANDS) - 1}}}" in rules["and0"]
    assert not any("*" in body or "+" in body for body in rules.values())
    literals = r'"(?:\\.|[^"\\])*"|\[(?:\\.|[^\]])*\]'
    used = set(re.findall(r"[a-z]+\d*", re.sub(literals, "", " ".join(rules.values()))))
    assert used == set(rules) - {"root"}
