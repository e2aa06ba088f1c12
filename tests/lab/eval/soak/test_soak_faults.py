"""The table of faults: whole, and named in docs/soak.md."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from simulated import simulated

from edge.config import load
from edge.errors import UserError
from edge.lab.eval.soak import injectors
from edge.lab.eval.soak.faults import FAULTS, choose_faults
from edge.lab.eval.soak.rules import GROWTHS, RULES

PAGE = (Path(__file__).parents[4] / "docs/soak.md").read_text(encoding="utf-8")


def test_the_page_has_every_fault():
    assert [fault.name for fault in FAULTS if f"`{fault.name}`" not in PAGE] == []


@pytest.mark.parametrize("rule", [*RULES, *GROWTHS], ids=lambda rule: rule.name)
def test_the_page_has_every_rule(rule):
    assert rule.name in PAGE


@pytest.mark.parametrize(
    ("calm", "age_s", "why"),
    [
        (True, None, ""),
        (True, 3.0, ""),
        (False, 12.0, ""),
        (True, 12.0, "the map file is 12 s old, allowed 10 s"),
    ],
    ids=["none yet", "fresh", "in a fault", "old"],
)
def test_a_map_is_held_to_be_fresh_without_a_fault(calm, age_s, why):
    (rule,) = (rule for rule in RULES if rule.name == "map")
    watch = SimpleNamespace(calm=calm, map_problem="")
    assert rule.problem(None, watch, {"places_age_s": age_s}) == why


def test_faults_have_names_of_their_own_and_bounds():
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)
    for fault in FAULTS:
        assert 0 < fault.lasts_s[0] <= fault.lasts_s[1]
        assert fault.within_s > 0


def test_without_a_router_or_model_none_can_be_killed():
    there = {fault.name for fault in choose_faults(simulated(), None)}
    assert "camera-gone" in there
    assert not there & {"router-killed", "model-killed", "model-stopped", "model-swapped"}
    assert [fault.name for fault in choose_faults(load("soak"), None)] == [f.name for f in FAULTS]


@pytest.mark.parametrize("name", ["", "no-such", "router-killed"])
def test_an_unknown_fault_lists_the_known_ones(name):
    with pytest.raises(UserError, match=r"--faults: .*camera-gone"):
        choose_faults(simulated(), [name])


def test_a_fault_named_twice_is_chosen_once():
    assert [f.name for f in choose_faults(simulated(), ["reload", "reload"])] == ["reload"]


@pytest.mark.parametrize(("exit_code", "connected"), [(None, 1), (-9, 0)])
def test_the_session_is_opened_again_only_to_a_live_service(exit_code, connected):
    calls = []
    harness = SimpleNamespace(
        service=SimpleNamespace(poll=lambda: exit_code),
        relay=SimpleNamespace(cut=lambda: None, connect=lambda: calls.append(1)),
    )
    injection = injectors.CUT_SESSION(harness, None)
    next(injection)
    injection.close()
    assert len(calls) == connected
