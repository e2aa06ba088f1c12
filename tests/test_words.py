"""Plain words (CONTRIBUTING, "Words"): docstrings, class names, messages, and names in the docs."""

from __future__ import annotations

import ast
import importlib
import re
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OPENER = re.compile(
    r'^ *r?"""\s*((?:What|Whether|Where|How|Who|Whose|Which|Of|Those)\b.*)', re.MULTILINE
)
"""A docstring that opens with a question word, or with Of or Those."""
CLASS = re.compile(r"^ *class ([A-Za-z]\w*)", re.MULTILINE)
BANNED = re.compile(
    r"\b(anew|beside|whoever|whomever|whosoever|wherever|taken up|takes up|amiss|aught|naught|"
    r"thereof|therein|whereof|whereby|ere|dearer|foretold|sought|besides|seldom)\b",
    re.IGNORECASE,
)
"""Words of the old dialect."""
QUOTED = re.compile(r"`[^`]*`|\"[^\"]*\"|--\w+|^ *\w+: ", re.MULTILINE)
"""Code, quotations and names of arguments in prose."""
NATURAL = (
    "edge/mission/language/",
    "edge/lab/sim/generator/",
    "edge/lab/eval/",
    "edge/names.py",
    "edge/tasks/sentences/phrases.py",
)
"""Files whose strings are sentences of people, or names that a seed depends on."""


def banned(text: str) -> list[str]:
    """Return the banned words of a prose text, without its code and quotations."""
    return BANNED.findall(QUOTED.sub("", text))


def sources(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def messages(path: Path) -> list[tuple[int, str]]:
    """Return the string constants with more than one word, docstrings and f-strings included."""
    strings = [
        node
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    return [(node.lineno, node.value) for node in strings if " " in node.value.strip()]


def comments(path: Path) -> list[tuple[int, str]]:
    lines = path.read_text(encoding="utf-8").splitlines()
    found = [(number, re.search(r"(?:^|  )# (.*)", line)) for number, line in enumerate(lines, 1)]
    return [(number, match[1]) for number, match in found if match]


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("", []),
        ('"""Return True if it moves."""', []),
        ('"""Whether it moves."""', ['Whether it moves."""']),
        ('    """Of the robot.', ["Of the robot."]),
        ('"""Offset in m."""', []),
    ],
)
def test_openers(source, found):
    assert OPENER.findall(source) == found


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", []),
        ("start again", []),
        ("start anew, whoever asks", ["anew", "whoever"]),
        ('the preposition "beside" and `anew`', []),
        ("wait here", []),
    ],
)
def test_banned_words(text, words):
    assert banned(text) == words


def test_no_docstring_opens_with_a_question_word():
    found = [
        f"{path.relative_to(ROOT)}: {line}"
        for path in sources("edge", "exporters", "perf", "tests")
        for line in OPENER.findall(path.read_text(encoding="utf-8"))
    ]
    assert found == []


def test_every_public_class_name_is_used_once():
    where = defaultdict(list)
    for path in sources("edge"):
        for name in CLASS.findall(path.read_text(encoding="utf-8")):
            where[name].append(str(path.relative_to(ROOT)))
    assert len(where) > 300
    assert {name: files for name, files in where.items() if len(files) > 1} == {}


def test_no_word_of_the_old_dialect():
    found = []
    for path in sources("edge", "exporters"):
        place = path.relative_to(ROOT).as_posix()
        if not BANNED.search(path.read_text(encoding="utf-8")):
            continue  # parsing takes 50 times as long
        texts = comments(path) + ([] if place.startswith(NATURAL) else messages(path))
        found += [f"{place}:{line}: {word}" for line, text in texts for word in banned(text)]
    for path in [*sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "config").rglob("*.y*ml"))]:
        text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
        found += [f"{path.relative_to(ROOT)}: {word}" for word in banned(text)]
    assert found == []


DEFINED = re.compile(r"^ *(?:async )?(?:def|class) (\w+)", re.MULTILINE)
"""The name of a function or class."""


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("", []),
        ("def begin_again(): ...", []),
        ("    def begin_anew(self): ...", ["anew"]),
        ("class Whoever: ...", ["Whoever"]),
        ("value = anew", []),
    ],
)
def test_old_words_in_names(source, words):
    assert old_words_in_names(source) == words


def old_words_in_names(source: str) -> list[str]:
    """Return the banned words in the names of functions and classes."""
    return [w for name in DEFINED.findall(source) for w in BANNED.findall(name.replace("_", " "))]


def test_no_function_has_a_name_of_the_old_dialect():
    found = [
        f"{path.relative_to(ROOT)}: {word}"
        for path in sources("edge", "exporters", "perf", "tests")
        for word in old_words_in_names(path.read_text(encoding="utf-8"))
    ]
    assert found == []


QUESTION = re.compile(
    r"def (test_(?:what|where|who|whose|how|whether|those|of)_\w+"
    r"|test_\w*_(?:what|where|who|whose|nobody|somebody|ones_own)(?:_\w+)?)\("
)
"""The name of a test that opens like a question, or has a relative pronoun in place of a noun."""


def test_test_names_state_a_fact():
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in sources("perf", "tests")
        for name in QUESTION.findall(path.read_text(encoding="utf-8"))
    ]
    assert found == []


def test_the_glossary_names_classes_that_exist():
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = page.split("## Words")[1].split("## Rules")[0]
    named = set(re.findall(r"`([A-Z][a-z]\w+|SE2)`", table))
    there = {
        name for path in sources("edge") for name in CLASS.findall(path.read_text(encoding="utf-8"))
    }
    assert len(named) > 30
    assert named - there == set()


ELSEWHERE = {"edge/_data/config/secure", "edge/ros2/", "models/request"}
"""A folder of an installed wheel; a key prefix; a topic."""
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_names_in_a_page_exist(page):
    text = page.read_text(encoding="utf-8")
    paths = re.findall(r"`((?:edge|exporters|tests|perf|config|models|docs)/[\w./-]+)`", text)
    assert [p for p in paths if p not in ELSEWHERE and not (ROOT / p).exists()] == []
    for name in re.findall(r"`(edge(?:\.[a-z_0-9]+)+(?:\.[A-Za-z_]\w*)*)`", text):
        assert resolves(name), f"{page.name}: {name}"
    for module, names in re.findall(r"^ *from (edge[\w.]*) import ([\w, ]+)$", text, re.MULTILINE):
        for name in names.split(", "):
            assert resolves(f"{module}.{name}"), f"{page.name}: {module}.{name}"


def resolves(name: str) -> bool:
    """Return True if a dotted name is a module or an attribute of one."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:cut]))
        except ImportError:
            continue
        for attribute in parts[cut:]:
            if not hasattr(value, attribute):
                return False
            value = getattr(value, attribute)
        return True
    return False


@pytest.mark.parametrize(
    ("name", "there"),
    [
        ("edge.policies", True),
        ("edge.policies.base.PolicyInput", True),
        ("edge.policies.base.Nothing", False),
        ("edge.no_such_module", False),
    ],
)
def test_names_resolve(name, there):
    assert resolves(name) is there


def test_the_readme_has_at_most_a_thousand_words():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 1000
