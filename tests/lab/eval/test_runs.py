"""Arms on episodes: the same outcomes from every way to run them, and each only once."""

from __future__ import annotations

import dataclasses
import os
import threading
from collections import deque
from typing import Any

import pytest

from edge.cli.main import main
from edge.lab.eval import drive, runs, workers
from edge.lab.eval.arms import make_arms
from edge.lab.eval.drive import run_episode
from edge.lab.eval.episodes import Episode, plan, read, write
from edge.lab.eval.outcome import TIMINGS, EpisodeOutcome, OutcomeFile
from edge.lab.eval.runs import count_outdated, run_all
from edge.lab.eval.workers import EpisodeJob, run_in_process, run_in_workers, take_job

ARMS = {"hvl": {}, "near": {"policy": {"kind": "nearest_frontier"}}}


def exact(outcome: EpisodeOutcome) -> dict[str, Any]:
    """All that does not depend on how fast the computer is."""
    return {k: v for k, v in dataclasses.asdict(outcome).items() if k not in TIMINGS}


@pytest.fixture(scope="module")
def tasks(config):
    episodes = plan(config, [], ["bed", "sofa"], 1, 0, 2.0)
    return [EpisodeJob(arm, e) for e in episodes for arm in make_arms(config, ARMS)]


@pytest.fixture(scope="module")
def alone(tasks):
    """Their outcomes in this process, one after the other."""
    return list(run_in_process(tasks, threading.Event()))


def test_no_tasks_have_no_outcomes():
    stop = threading.Event()
    assert list(run_in_process([], stop)) == []
    assert list(run_in_workers([], 2, stop)) == []


def test_an_episode_replays_the_same_and_has_its_mission_log(tasks, alone):
    task, first = tasks[0], alone[0]
    assert exact(run_episode(task.arm, task.episode)) == exact(first)
    assert first.success
    assert (first.failure, first.wrong_stops, first.left_m) == (None, 0, 0.0)
    assert first.path_m >= first.shortest_m > 0.0
    assert first.distance_m <= 1.0
    assert 0.0 <= first.first_sight_s <= first.elapsed_s
    assert first.first_sight_path_m <= first.path_m
    assert first.trail[0] == pytest.approx(task.episode.start[:2], abs=1e-3)
    assert len(first.goal_xy) == first.goals > 0
    assert first.tick_ms["p50"] <= first.tick_ms["p95"] <= first.tick_ms["max"]


def test_processes_give_the_same_outcomes(tasks, alone):
    shared = {o.key: exact(o) for o in run_in_workers(tasks[1:3], 2, threading.Event())}
    assert shared == {o.key: exact(o) for o in alone[1:3]}
    assert len(shared) == 2


def fallen(task: EpisodeJob) -> list[EpisodeOutcome]:
    """Stand-in for the worker's run: it crashes at the sofa."""
    if task.episode.target == "sofa":
        os._exit(7)
    return [run_episode(task.arm, task.episode)]


def serve_fallen(pipe):
    workers.run_job = fallen
    workers._serve(pipe)


def test_a_process_that_falls_over_fails_its_episode_only(tasks, monkeypatch):
    # A child imports this module by its name, and does not see the patches.
    real, started = workers.get_context("spawn"), []

    class Context:
        Pipe = staticmethod(real.Pipe)

        @staticmethod
        def Process(target, **options):
            started.append(target)
            return real.Process(target=serve_fallen, **options)

    monkeypatch.setattr(workers, "get_context", lambda kind: Context)
    some = [tasks[0], tasks[2], tasks[3]]
    outcomes = list(run_in_workers(some, 1, threading.Event()))
    assert [(o.target, o.success) for o in outcomes] == [
        ("bed", True), ("sofa", False), ("sofa", False),
    ]  # fmt: skip
    assert outcomes[1].reason == "crashed: its worker process ended (exit code 7)"
    assert len(started) == 2


def test_an_error_fails_its_episode_only(tasks, monkeypatch):
    real = drive.ClosedLoop

    def broken(config, **options):
        if config.mission.target == "sofa":
            raise RuntimeError("out of order")
        return real(config, **options)

    monkeypatch.setattr(drive, "ClosedLoop", broken)
    outcomes = list(run_in_process([tasks[0], tasks[2]], threading.Event()))
    assert [o.failure for o in outcomes] == [None, "crashed"]
    assert "out of order" in outcomes[1].reason


def test_an_episode_ends_though_its_mission_does_not(tasks, monkeypatch):
    monkeypatch.setattr("edge.mission.run.MissionRun.check_limits", lambda *_: None)
    monkeypatch.setattr("edge.loop.service.Service._select", lambda *_: None)
    arm, episode = tasks[0].arm, tasks[0].episode
    outcome = run_episode(arm, episode)
    assert outcome.reason == "no end after 66 s"
    assert (outcome.success, outcome.failure) == (False, "stuck")
    assert outcome.elapsed_s == pytest.approx(66.0, abs=0.21)  # a step


def test_after_a_stop_nothing_begins_and_nothing_is_kept(config, tasks, tmp_path):
    stop = threading.Event()
    stop.set()
    assert list(run_in_process(tasks, stop)) == []
    assert list(run_in_workers(tasks, 2, stop)) == []
    episodes = plan(config, [], ["bed"], 1, 0, 2.0)
    assert run_all(make_arms(config, {}), episodes, tmp_path / "out", stop=stop) == []
    assert OutcomeFile(tmp_path / "out").known == {}


def test_an_interrupted_run_resumes(config, tmp_path):
    episodes, out = plan(config, [], ["bed", "sofa"], 1, 0, 2.0), tmp_path / "out"
    stop, reported = threading.Event(), []

    def tell(number, total, outcome):
        reported.append((number, total, outcome.key))
        stop.set()

    arms = make_arms(config, ARMS)
    first = run_all(arms, episodes, out, on_outcome=tell, stop=stop)
    assert [(number, total) for number, total, _ in reported] == [(1, 4)]
    rest = run_all(arms, episodes, out, on_outcome=lambda *news: reported.append(news))
    assert len({news[2] if i == 0 else news[2].key for i, news in enumerate(reported)}) == 4
    assert len(first) == 1
    assert [(o.episode, o.arm) for o in rest] == [(e.id, c.name) for e in episodes for c in arms]
    assert read(out / "episodes.jsonl") == episodes
    run_all(arms, episodes, out, on_outcome=lambda *news: pytest.fail("run again"))


def test_changed_arms_and_crashes_are_run_again(config, tmp_path, monkeypatch):
    episodes, out = plan(config, [], ["bed"], 1, 0, 2.0), tmp_path / "out"
    (arm,) = make_arms(config, {"it": {}})
    with monkeypatch.context() as patched:
        patched.setattr(drive, "ClosedLoop", lambda *_, **__: 1 / 0)
        (crash,) = run_all([arm], episodes, out)
    assert crash.failure == "crashed"
    (good,) = run_all([arm], episodes, out)
    assert good.success
    (other,) = make_arms(config, {"it": {"policy": {"kind": "nearest_frontier"}}})
    assert count_outdated([arm], out) == {}
    assert count_outdated([other], out) == {"it": 1}
    (other_run,) = run_all([other], episodes, out)
    assert other_run.arm_id == other.id != good.arm_id


def test_a_mission_with_several_targets_is_judged_at_each(config):
    (there,) = plan(config, [], ["bed"], 1, 0, 2.0)
    instructed = dataclasses.replace(
        there, target=None, instruction="go to the sofa, then go to the bed", shortest_m=4.0
    )
    (arm,) = make_arms(config, {})
    outcome = run_episode(arm, instructed)
    assert outcome.success, outcome.reason
    assert (outcome.target, outcome.distance_m) == (None, None)
    assert outcome.reason == "sofa, then bed"


# -- the command ----------------------------------------------------------------------------------


@pytest.fixture
def yaml_path(config, tmp_path):
    path = tmp_path / "small.yaml"
    path.write_text(
        "perception: {detector: {kind: sim}}\n"
        f"sim: {{world: {{kind: house, house: {config.sim.world.house}}}, step_s: 0.2}}\n"
    )
    return str(path)


COMMAND = ["eval", "episodes"]


def test_the_simple_use_prints_a_table(yaml_path, capsys):
    asked = ["--targets", "sofa,bed", "--starts", "1", "--min-distance", "2"]
    assert main([*COMMAND, yaml_path, *asked]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("  1/2 ok   hvl")
    assert lines[3:5] == ["Arms", lines[4]]
    assert lines[4].split()[:4] == ["arm", "n", "SR,", "%"]
    assert lines[5].split()[:3] == ["hvl", "2", "100.0"]
    assert {"By target", "Failures", "On the way"} <= set(lines)


def test_a_plan_is_written_and_run_in_columns(yaml_path, tmp_path, capsys):
    file, out = tmp_path / "episodes.jsonl", tmp_path / "out"
    asked = ["--targets", "bed", "--starts", "2", "--min-distance", "2", "--plan", str(file)]
    assert main([*COMMAND, yaml_path, *asked]) == 0
    assert capsys.readouterr().out == f"{file}: 2 episodes\n"
    run = [*COMMAND, yaml_path, "--episodes", str(file), "--limit", "1", "--out", str(out)]
    arms = ["--arm", "hvl", "--arm", "near", "policy.kind=nearest_frontier"]
    assert main([*run, *arms]) == 0
    assert [o.arm for o in OutcomeFile(out).known.values()] == ["hvl", "near"]
    capsys.readouterr()
    assert main([*run, "--arm", "hvl", "policy.w_dist=1.5"]) == 0
    printed = capsys.readouterr().out
    assert "arm hvl: its settings have changed, so 1 earlier outcomes are not used" in printed


def test_the_textured_benchmark_has_its_own_defaults(yaml_path, tmp_path, monkeypatch):
    asked: list[Any] = []

    def planned(config, worlds, targets, starts, seed, distance, per_world, size, limit):
        asked.append((len(worlds), worlds[0]["seed"], targets, starts, per_world))
        return [Episode("id", worlds[0], (0.0, 0.0, 0.0), "bed", None, 5.0, {})]

    monkeypatch.setattr(runs.eps, "plan", planned)
    command = ["eval", "textured", yaml_path, "--plan", str(tmp_path / "plan"), "--targets", "bed"]
    assert main(command) == 0
    assert main([*command, "--worlds", "furnished[3:5]", "--starts", "2"]) == 0
    assert asked == [(125, 1000, ["bed"], 1, 4), (2, 3, ["bed"], 2, None)]


WORLDS = {"a": {"kind": "generated", "seed": 1}, "b": {"kind": "generated", "seed": 2}}


@pytest.mark.parametrize(
    ("waiting", "loaded", "others", "taken"),
    [
        ("aabb", None, "", 0),
        ("aabb", "b", "", 2),
        ("aabb", None, "a", 2),
        ("aabb", "b", "ab", 2),
        ("aa", "b", "a", 0),
        ("abab", "a", "b", 0),
    ],
)
def test_a_worker_stays_in_its_world(waiting, loaded, others, taken):
    jobs = deque(
        EpisodeJob(None, Episode(str(k), WORLDS[w], (0.0, 0.0, 0.0), "bed", None, 5.0, {}))
        for k, w in enumerate(waiting)
    )
    job = take_job(jobs, WORLDS.get(loaded), [WORLDS[w] for w in others])
    assert job.episode.id == str(taken)
    assert [j.episode.id for j in jobs] == [str(k) for k in range(len(waiting)) if k != taken]


def test_a_target_may_be_a_room(config):
    (there,) = plan(config, [], ["living room"], 1, 0, 2.0)
    (arm,) = make_arms(config, {})
    outcome = run_episode(arm, there)
    found = outcome.success, outcome.target, outcome.distance_m
    assert found == (True, "living room", 0.0), outcome.reason
    assert 2.0 <= outcome.shortest_m <= outcome.path_m


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--targets", " , "], "--targets: got no name; give at least one"),
        (["--arm", "a", "--arm", "a"], "--arm a: two arms have this name"),
        (["--arm", "a", "policy.kind=b"], "unknown 'b'"),
        (["--episodes", "nowhere.jsonl"], "nowhere.jsonl"),
        (["--worlds", "demo"], "--worlds demo: no such world"),
        (["--goals", "2", "--targets", "bed"], "no world has 2 of the targets"),
        (["--ask", "--targets", "bed,kitchen"], "--targets: kitchen: --missions and --ask take no"),
    ],
)
def test_invalid_options_are_reported_before_the_run(yaml_path, capsys, options, message):
    assert main([*COMMAND, yaml_path, *options]) != 0
    assert message in capsys.readouterr().err


def test_the_tasks_of_episodes_exclude_each_other(yaml_path, capsys):
    with pytest.raises(SystemExit):
        main([*COMMAND, yaml_path, "--goals", "2", "--zones"])
    assert "--zones: not allowed with argument --goals" in capsys.readouterr().err


def test_a_session_has_no_report(yaml_path, tmp_path, capsys):
    asked = ["--goals", "2", "--targets", "bed,sofa", "--min-distance", "1"]
    assert main([*COMMAND, yaml_path, *asked, "--report", str(tmp_path / "pages")]) != 0
    assert "--report: not possible with sessions" in capsys.readouterr().err


def test_a_report_of_every_episode(yaml_path, tmp_path, config):
    (there,) = plan(config, [], ["bed"], 1, 0, 2.0)
    write(tmp_path / "e.jsonl", [there])
    folder = tmp_path / "pages"
    run = ["--episodes", str(tmp_path / "e.jsonl"), "--report", str(folder)]
    assert main([*COMMAND, yaml_path, *run]) == 0
    assert len(OutcomeFile(folder).known) == 1
    assert [page.parent.name for page in folder.glob("*/*.html")] == [
        f"{there.id.replace('/', '-')}-hvl"
    ]
