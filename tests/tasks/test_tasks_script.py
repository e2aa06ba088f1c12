"""Scripts of a model: allowed calls, and errors of failing ones.

Hostile scripts are in tests/attacks.
"""

from __future__ import annotations

import logging
import re
import sys

import pytest
from pydantic_monty._binary import find_monty_binary
from task_scenes import STREET, street

from edge.config import TrajectoryLimits
from edge.errors import UnavailableError
from edge.tasks.functions import ScriptFunctions
from edge.tasks.scene.ground import ground_of
from edge.tasks.script import ScriptLimits, run_script

LIMITS = TrajectoryLimits()
GROUND = ground_of(street(*STREET), LIMITS.clearance_m)


@pytest.fixture
def functions():
    return ScriptFunctions(GROUND, LIMITS)


PASS_THE_VAN = """
import math
van = det_object("van")[0]
gate = det_object("gate")[0]
here = robot()["position"]
beside = nearest_reachable(offset(van["id"], "left", 1.2))
past = nearest_reachable(offset(van["id"], "behind", 2.0))
stop = gate["nearest_reachable"][1]
first = a_star_plan(here, beside) + a_star_plan(beside, past)[1:]
second = a_star_plan(past, stop, regions=[1])
print(f"{math.degrees(heading(here, beside)):.0f} degrees", len(det_object()))
visual_3d(first + second)
give_trajectory([first, second], [1], speed_mps=0.8)
"""


def test_a_script_gives_a_trajectory(functions):
    outcome = run_script(PASS_THE_VAN, functions, ScriptLimits())
    assert (outcome.printed.split(), outcome.error) == (["15", "degrees", "5"], "")
    coarse = functions.trajectory
    assert [len(points) > 3 for points in coarse.segments] == [True, True]
    assert (coarse.regions, coarse.speed_mps, len(functions.shown_trajectories)) == ((1,), 0.8, 1)
    assert coarse.points_m[-1].tolist() == pytest.approx([14.8, 2.0])


@pytest.mark.parametrize(
    ("code", "error"),
    [
        ("x = 1 +", "line 1: Expected an expression"),
        ("\n\nfoo()", "line 3: NameError: name 'foo' is not defined"),
        ("offset(1, 'top')", "line 1: ValueError: offset: side: expected behind, left, "),
        ("offset(1)", r"line 1: TypeError: offset: missing a required argument: 'side'; call it as "
                      r"offset\(id, side, distance_m=1.0, seen_from=None\)"),
        ("give_trajectory([(8, 0)])", "line 1: ValueError: point 1 of segment 1, .* is occupied"),
        ("import numpy", "line 1: ModuleNotFoundError: No module named 'numpy'"),
        ("raise ValueError('a\\n\\x1b[31mb')", r"line 1: ValueError: a \[31mb$"),
    ],
)  # fmt: skip
def test_an_error_is_one_line_with_its_place(functions, code, error):
    outcome = run_script(code, functions, ScriptLimits())
    assert functions.trajectory is None

    assert re.match(error, outcome.error), outcome.error
    assert outcome.error.isprintable()


def test_a_script_can_catch_an_error_and_retry(functions):
    code = """
try:
    give_trajectory([(8.0, 0.0)])
except ValueError as error:
    print(error)
    give_trajectory([robot()["position"]])
"""
    outcome = run_script(code, functions, ScriptLimits())
    assert outcome.error == ""
    assert "is occupied" in outcome.printed
    assert len(functions.trajectory.segments) == 1


def test_printed_text_is_cut_and_printable(functions):
    outcome = run_script(
        "print('\\x1b[2J' + 'x' * 9000)", functions, ScriptLimits(max_printed_chars=50)
    )
    assert len(outcome.printed) == 50
    assert outcome.printed.isprintable()


def test_an_internal_error_is_logged_but_not_shown(functions, monkeypatch, caplog):
    def broken(self, *_):
        raise KeyError("/home/somebody/secret")

    monkeypatch.setattr(ScriptFunctions, "distance", broken)
    with caplog.at_level(logging.ERROR):
        outcome = run_script("distance((0, 0), (1, 1))", functions, ScriptLimits())
    says = "line 1: RuntimeError: distance: internal error; do not call this function again"
    assert outcome.error == says
    assert "secret" in caplog.text


def test_a_script_that_is_too_long_is_not_run(functions):
    outcome = run_script("#" * 101, functions, ScriptLimits(max_chars=100))
    assert outcome.error == "the script has 101 characters, at most 100"


def test_without_the_interpreter_the_error_names_the_package(functions, monkeypatch):
    monkeypatch.setitem(sys.modules, "pydantic_monty", None)
    with pytest.raises(UnavailableError, match=r"pip install 'edge-vln\[tasks\]', or choose "):
        run_script("1", functions, ScriptLimits())


def test_a_missing_monty_program_is_reported(functions, monkeypatch, tmp_path):
    monkeypatch.setenv("MONTY_BIN", str(tmp_path / "none"))
    with pytest.raises(UnavailableError, match="pydantic-monty does not run here: "):
        run_script("1", functions, ScriptLimits())


def test_a_slow_start_of_the_interpreter_takes_no_time_of_the_script(
    functions, monkeypatch, tmp_path
):
    program = tmp_path / "monty"
    program.write_text(f'#!/bin/sh\nsleep 1.1\nexec "{find_monty_binary()}" "$@"\n')
    program.chmod(0o700)
    monkeypatch.setenv("MONTY_BIN", str(program))
    code = "give_trajectory([(0, 0), (1, 0)])"
    assert run_script(code, functions, ScriptLimits(time_s=0.5)).error == ""
