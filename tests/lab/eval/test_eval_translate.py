"""`edge eval translate`: comparing languages, counting outcomes."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ltl_semantics import holds

from edge.chat import ChatError
from edge.cli.parsers import make_parser
from edge.config import TranslatorGrammar
from edge.errors import UserError
from edge.lab.eval import translate, translation_cases
from edge.lab.eval.equivalence import distinguishing_trace, satisfiable
from edge.lab.eval.translation_cases import MAY_REFUSE, TO_READ
from edge.mission.logic.automaton import NOTHING, CompileError, compile_formula
from edge.mission.logic.ltl import Formula, ap, conj, disj, neg, parse
from edge.mission.translate import Translation, make_translator

LANG2LTL = Path(__file__).parents[4] / "shared/nl2ltl/lang2ltl/symbolic_batch12_noperm.csv"


@pytest.fixture(autouse=True)
def _few_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    """To make all tasks of the benchmark takes seconds."""
    monkeypatch.setattr(translate, "_TASKS", 60)


DIFFERENT = [
    ("F a", "F b", ("a",)),
    ("F a", "F(a | b)", ("b",)),
    ("!b U a", "!b W a", ()),
    ("F(a & F a)", "F(a & X F a)", ("a",)),
]


@pytest.mark.parametrize(("a", "b", "word"), DIFFERENT)
def test_different_languages_have_a_shortest_witness(a: str, b: str, word: tuple[str, ...]) -> None:
    f, g = parse(a), parse(b)
    assert distinguishing_trace(f, g) == word
    assert holds(f, word) != holds(g, word)


LEAVES = st.sampled_from("abc").map(ap)


def _combine(children: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    return st.one_of(
        st.builds(neg, children),
        st.builds(conj, children, children),
        st.builds(disj, children, children),
        st.builds(
            lambda op, f: Formula(op, (f,)), st.sampled_from(["F", "G", "X", "WX"]), children
        ),
        st.builds(
            lambda op, f, g: Formula(op, (f, g)), st.sampled_from("UWRM"), children, children
        ),
    )


FORMULAS = st.recursive(LEAVES, _combine, max_leaves=5)
WORDS = st.lists(st.sampled_from(["a", "b", "c", NOTHING]), max_size=5)


@given(FORMULAS, FORMULAS, WORDS)
def test_difference_agrees_with_the_definition(f: Formula, g: Formula, word: list[str]) -> None:
    witness = distinguishing_trace(f, g)
    if witness is None:
        assert holds(f, word) == holds(g, word)
    else:
        assert holds(f, witness) != holds(g, witness)


@given(FORMULAS, FORMULAS, WORDS)
def test_a_silent_end_is_many_steps_of_nothing(f: Formula, g: Formula, word: list[str]) -> None:
    """As many as there are states: then nothing changes any more."""
    silence = [NOTHING] * (compile_formula(f).n_states + compile_formula(g).n_states)
    witness = distinguishing_trace(f, g, silent_end=True)
    if witness is None:
        assert holds(f, word + silence) == holds(g, word + silence)
    else:
        assert holds(f, [*witness, *silence]) != holds(g, [*witness, *silence])
    if holds(f, word + silence):
        assert satisfiable(f)


@pytest.mark.parametrize(
    ("text", "infix"),
    [
        ("F a", "F a"),
        ("& F a F b", "F a & F b"),
        ("& & a b & c d", "a & b & c & d"),
        ("| & a b | c d", "a & b | c | d"),
        ("G i a X ! b", "G (a -> X !b)"),
        ("G e a X b", "G (a <-> X b)"),
        ("M & a F b | ! a b", "(a & F b) M (!a | b)"),
    ],
)
def test_prefix(text: str, infix: str) -> None:
    assert translation_cases.from_prefix(text) == parse(infix)


@pytest.mark.parametrize("text", ["", "& a", "a b", "F a F"])
def test_an_invalid_prefix_formula_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"too few operands|expected one formula"):
        translation_cases.from_prefix(text)


TABLE = """pattern_type,props,utterance,ltl_formula
visit,['a'],visit a,F a
visit,['a'],hum a,F a
past_avoidance,"['a', 'b']",visit c and do not go to a until you see b,& F c U ! a b
global_avoidance,['a'],visit a,G ! a
patrolling,['a'],keep visiting a,G F a
past_avoidance,"['a', 'b']",a must be visited before b,& F a F b
"""


def test_outcomes(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(TABLE)
    cases, left_out = translation_cases.lang2ltl_cases(path)
    assert left_out == Counter(patrolling=1)
    translator = make_translator(TranslatorGrammar())
    scores = [translate.score(case, translator) for case in cases]
    assert [s.outcome for s in scores] == ["right", "refused", "right if weak", "wrong", "asked"]
    counts = translate.summary(scores, left_out)
    assert counts["cases"] == 5
    assert counts["not_expressible"] == 1
    assert counts["parts"]["visit"]["right"] == 1
    table = translate.table("set", counts)
    *_, every, share = table.splitlines()
    assert every.split() == ["all", "5", "1", "1", "1", "1", "1", "1"]
    assert share.split() == ["share", *5 * ["20.0", "%"]]


OWN = """sentence\tright
"visit the bed"\t["F bed"]
"visit the bed twice"\t["F bed", "F (bed & F (!bed & F bed))"]
"visit the bed or the sofa"\t["F bed"]
"fly to the moon"\t[[]]
"visit, …"\t["LONG"]
"""


def test_custom_sentences_are_scored(tmp_path: Path) -> None:
    path = tmp_path / "own.tsv"
    path.write_text(OWN, encoding="utf-8")
    cases, left_out = translation_cases.custom_cases(path)
    assert left_out == Counter({TO_READ: 1})
    assert [case.part for case in cases] == [TO_READ] * 3 + [MAY_REFUSE]
    translator = make_translator(TranslatorGrammar())
    outcomes = [translate.score(case, translator).outcome for case in cases]
    assert outcomes == ["right", "right", "wrong", "refused"]
    for text in ("sentence\nno json", 'x\n"a"\t["F ("]', 'x\n"a"\t3', 'x\n"a"'):
        path.write_text(text)
        with pytest.raises(UserError, match="not readable as a table of sentences"):
            translation_cases.custom_cases(path)


def _run(*argv: str) -> int:
    return translate.run(make_parser().parse_args(["eval", "translate", *argv]))


def test_run_writes_counts_and_failures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, out, failures = (tmp_path / name for name in ("t.csv", "o.json", "f.jsonl"))
    table.write_text(TABLE)
    code = _run("--limit", "20", "--lang2ltl", str(table), "--out", str(out),
                "--failures", str(failures), "--backend", "grammar", "auto")  # fmt: skip
    assert code == 0
    counts = json.loads(out.read_text())
    for name in ("grammar", "auto"):
        assert counts["ViTL tasks"][name]["right"] == counts["ViTL tasks"][name]["cases"] == 20
    assert counts["Lang2LTL"]["grammar"]["right if weak"] == 1
    rows = [json.loads(line) for line in failures.read_text().splitlines()]
    failed = [row for row in rows if row["translator"] == "grammar"]
    assert [row["outcome"] for row in failed] == ["refused", "right if weak", "wrong", "asked"]
    assert failed[2]["differ_on"] == []
    output = capsys.readouterr().out
    assert "ViTL tasks, auto" in output
    assert "100.0 %" in output


class _Failing:
    """Fails at the third case with `error`."""

    def __init__(self, error: BaseException) -> None:
        self.asked: list[str] = []
        self._error = error
        self._inner = make_translator(TranslatorGrammar())

    def translate(self, instruction: str) -> Translation:
        self.asked.append(instruction)
        if len(self.asked) == 3:
            raise self._error
        return self._inner.translate(instruction)


@pytest.mark.parametrize(
    ("error", "raised", "words"),
    [
        (ChatError("http://x: down"), UserError, "ViTL tasks, llm: stopped after 2 of 9: http://x"),
        (KeyboardInterrupt(), KeyboardInterrupt, None),
    ],
)
def test_an_interrupted_scoring_keeps_the_finished_cases(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    error: BaseException, raised: type[BaseException], words: str | None,
) -> None:  # fmt: skip
    translator = _Failing(error)
    monkeypatch.setattr(translate, "make_translator", lambda config: translator)
    table, out = tmp_path / "t.csv", tmp_path / "o.json"
    table.write_text(TABLE)
    with pytest.raises(raised, match=words):
        _run("--backend", "llm", "--limit", "9", "--out", str(out), "--lang2ltl", str(table))
    assert len(translator.asked) == 3  # the other set is not begun
    counts = json.loads(out.read_text())["ViTL tasks"]["llm"]
    assert (counts["cases"], counts["right"], counts["refused"]) == (2, 2, 0)
    assert "ViTL tasks" in capsys.readouterr().out


def test_a_formula_too_large_to_compare_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    def too_large(*_: object) -> None:
        raise CompileError("more than 10 states")

    monkeypatch.setattr(translate, "distinguishing_trace", too_large)
    case = translation_cases.benchmark_cases(1)[0]
    with pytest.raises(CompileError):
        translate.score(case, make_translator(TranslatorGrammar()))


def test_run_reports_skipped_data_sets(capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("--limit", "1", "--backend", "grammar") == 0
    assert "--lang2ltl" in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"a,b\n1,2\n", b"\xff\xfe\x00", b"ltl_formula\nU\n"])
def test_another_file_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.csv"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"other\.csv: not readable"):
        translation_cases.lang2ltl_cases(path)


@pytest.mark.skipif(not LANG2LTL.exists(), reason="needs ../shared/nl2ltl")
def test_lang2ltl_cases_exclude_patrolling() -> None:
    cases, left_out = translation_cases.lang2ltl_cases(LANG2LTL)
    assert (len(cases), left_out) == (1031, Counter(patrolling=125))
