"""Tests of `edge.mission.language.words.templates`: texts that fit a sentence template."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from edge.lab.eval.everyday import everyday_cases
from edge.mission.language import intents
from edge.mission.language.errands import outcomes, spell_out
from edge.mission.language.words.templates import (
    SentenceTemplate,
    compile_templates,
    first_match,
    pattern,
)

EVERYDAY = Path(__file__).with_name("everyday.jsonl")
PARTS = {"go": "(go|drive) [on]", "may": "[please|now]*", "any": "(go|[fast])", "both": "a|b c"}


@pytest.mark.parametrize(
    ("template", "fits", "fails"),
    [
        ("stop", ["stop", "STOP"], ["", "stops", "go"]),
        ("where (is|are) <object>", ["where is the mug", "Where ARE my keys"], ["where the mug"]),
        ("{go} home", ["go home", "drive on home"], ["home", "run home"]),
        ("{may} stop {may}", ["stop", "please now stop now"], ["please"]),
        ("(very)* good", ["good", "very very good"], ["very"]),
        ("{any} home", ["home", "go home", "fast home"], ["slow home"]),
        ("{both} d", ["a d", "b c d"], ["b d", "a b c d"]),
        ("go , now", ["go now", "go, now"], ["go,now"]),
        ("wait ...", ["wait", "wait a little"], ["wait then stop"]),
        ("a|b c", ["a", "b c"], ["c"]),
    ],
)
def test_a_template_fits_a_text(template, fits, fails):
    (compiled,) = compile_templates(template, PARTS)
    regex = re.compile(pattern(template, PARTS), re.I)
    for text in (*fits, *fails):
        assert (compiled.fullmatch(f" {text}") is not None) is (text in fits), text
        assert (regex.fullmatch(f" {text}") is not None) is (text in fits), text


def test_templates_match_and_replace_inside_a_text():
    (template,) = compile_templates("go (home|back)", {})
    assert template.match(" go back, then stop")
    assert not template.match(" now go back")
    assert template.sub(lambda found: " stop", " run, go home. Go back!") == " run, stop. stop!"
    assert template.sub(lambda found: " stop", " go away") == " go away"


def test_the_first_template_that_fits_gives_the_slots():
    templates = compile_templates("find <object>\n    find <object> [now]\nfind", {})
    assert first_match(templates, "find the mug") == {"object": "the mug"}
    assert first_match(templates, "find") == {}
    assert first_match(templates, "stop") is None


def test_no_template_is_left_out_for_a_text_that_fits_it():
    """A sample: all templates and every twentieth sentence."""
    rules = [part for rule, _ in spell_out._rules() for part in rule]
    groups = (*intents._templates().values(), rules, [row[0] for row in outcomes._conditions()])
    templates = [one for group in groups for one in group if isinstance(one, SentenceTemplate)]
    said = [case["said"] for case in everyday_cases(EVERYDAY)]
    texts = ["i can not find my keys . have you seen them", *said[::20]]
    left_out = [
        (template._template, text)
        for text in texts
        for template in templates
        if not template._may_fit(f" {text}") and template._regex.search(f" {text}")
    ]
    assert len(templates) > 200
    assert left_out == []
