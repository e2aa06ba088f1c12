"""The progress line: its words, its beat, and that it fits the terminal."""

from __future__ import annotations

import io
from functools import partial
from types import SimpleNamespace

import pytest
from results import facts, result
from simulated import simulated
from task_facts import INSTRUCTION, by_a_model, driving, looking, steps, written

from edge.cli import console
from edge.cli.console import ConsoleSink, status_line
from edge.geometry import SE2
from edge.logs import CLEAR_LINE
from edge.loop.latency import LatencyRing
from edge.loop.result import TickResult, mission_facts
from edge.loop.stages import DETECT
from edge.mission.run import MissionRun
from edge.mission.spec import prepare
from edge.tasks.facts import lengths_m
from edge.types import Goal, MissionStatus

LENGTH_M = lengths_m(written()[1], 0)[0]
S, MS = 1_000_000_000, 1_000_000


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def wall(monkeypatch) -> SimpleNamespace:
    """Fake of the module `time`; it stands still unless the test sets it."""
    wall = SimpleNamespace(now_ns=0)
    wall.monotonic_ns = lambda: wall.now_ns
    monkeypatch.setattr(console, "time", wall)
    return wall


def latency() -> LatencyRing:
    ring = LatencyRing()
    ring.begin_tick(0)
    ring.span(DETECT, 9 * MS)
    ring.end_tick(2 * MS)
    return ring


@pytest.mark.parametrize(("target", "label"), [("couch", "couch"), ("every couch", "couch")])
def test_the_status_line_of_a_driving_robot(target, label):
    line = status_line(
        result(
            status=MissionStatus(target, "approaching", elapsed_s=61.26),
            targets={target: label},
            pose=SE2(1.0, 0.0, 0.0),
            goal=Goal(0, SE2(2.0, 0.0, 0.0), "instance", 1, (2.24, 0.0), 0.5, "couch"),
            mission=facts,
            instances=lambda: [SimpleNamespace(label=label) for label in ("sofa", "sofa", "bed")],
            known_m2=lambda: 40.6,
            latency=latency().report,
        )
    )
    assert line == (
        f"61.3s approaching {target} | instance 1.2 m | 2 seen | map 41 m2 "
        "| tick p95 2.0 ms | detector 9 ms"
    )


@pytest.mark.parametrize(
    ("formula", "ahead"),
    [
        ("F chair", "chair |"),
        ("F(chair & F sofa)", "chair (then sofa) |"),
        ("F(chair & X F(sofa & X X F chair))", "chair (then sofa, nothing, chair) |"),
    ],
)
@pytest.mark.parametrize("phase", ["searching", "failed"])
def test_the_line_names_the_target_and_the_next_ones(formula, ahead, phase):
    line = status_line(of(formula, phase))
    assert (ahead if phase == "searching" else "chair |") in line


def test_a_long_plan_is_cut():
    objects = ("bed", "bench", "bottle", "bowl", "box", "candle", "chair", "clock", "cup", "desk")
    line = status_line(of(" & ".join(f"F {obj}" for obj in objects)))
    assert len(line.partition(" | ")[0]) < 120


def of(formula: str, phase: str = "searching") -> TickResult:
    config = simulated().mission
    run = MissionRun(prepare(config, formula=formula), config)
    run.start(0)
    status = MissionStatus(run.target, phase)
    return result(status=status, mission=partial(mission_facts, run))


@pytest.mark.parametrize(("stream", "written"), [(Terminal, 10), (io.StringIO, 1)])
def test_beat(wall, stream, written):
    out = stream()
    sink = ConsoleSink(out)
    for k in range(60):  # two seconds of a 30 Hz loop
        wall.now_ns = k * S // 30
        sink.tick(result())
    assert out.getvalue().count("looking for chair") == written


def test_a_terminal_gets_one_line_that_fits(wall):
    out = Terminal()
    sink = ConsoleSink(out)
    for k in range(3):
        wall.now_ns = k * S
        sink.tick(result(status=MissionStatus("x" * 300, "searching"), mission=facts))
    sink.close()
    lines = out.getvalue().removesuffix("\n").split(CLEAR_LINE)
    assert (lines[0], len(lines)) == ("", 4)
    assert all(len(line) < 80 and "\n" not in line for line in lines)
    assert out.getvalue().endswith("\n")


@pytest.mark.parametrize(
    ("task", "line"),
    [
        (looking(), f"looking for van, gate, to {INSTRUCTION} | step 1 of 2 | no goal | 0 seen |"),
        (looking(missing=()), f"looking for what is around, to {INSTRUCTION} | step 1 of 2 |"),
        (looking(phase="writing"), f"writing {INSTRUCTION} | step 1 of 2 | by rules | map"),
        (
            looking(phase="failed", writer="a\x1b[2J", rounds=by_a_model().rounds),
            f"failed {INSTRUCTION} | step 1 of 2 | by a[2J, 2 answers | map",
        ),
        (
            driving(0, steps=steps("driven", "under way")),
            f"driving {INSTRUCTION} | step 2 of 2 | 0.0 of {LENGTH_M:.1f} m | map",
        ),
        (
            driving(10_000, phase="reached", steps=steps("driven", "driven")),
            f"reached {INSTRUCTION} | {LENGTH_M:.1f} of {LENGTH_M:.1f} m | map",
        ),
    ],
)
def test_the_status_line_shows_the_phase_of_a_task(task, line):
    status = MissionStatus("van", "searching", elapsed_s=12.3)
    output = status_line(result(status=status, pose=SE2(0.0, 0.0, 0.0), task=lambda: task))
    assert output.startswith(f"12.3s {line}")
