"""`edge eval trajectories`: results of methods, saved files and printed tables."""

from __future__ import annotations

import json
import math
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from chat_server import saying, serving
from made_episodes import episode

from edge.cli.main import main
from edge.cli.parsers import make_parser
from edge.config import TasksConfig, WriterModel
from edge.errors import FileError, UserError
from edge.lab.eval.trajectories import methods
from edge.lab.eval.trajectories import run as trajectory_run
from edge.lab.eval.trajectories.episodes import episodes
from edge.lab.eval.trajectories.methods import METHODS, methods_of, run_methods
from edge.lab.eval.trajectories.outcomes import ResultsFolder, gather
from edge.lab.eval.trajectories.run import run, run_all

RULES = TasksConfig()
PAST = "drive past the left of the van, then stop at the gate"
SCRIPT = """```python
way = a_star_plan(robot()["position"], det_object("gate")[0]["nearest_reachable"][1])
give_trajectory([way], [1])
```"""


def ran(found, names, folder, config=RULES):
    return [folder.outcomes[key] for key in run_all(found, names, config, folder)]


def test_no_episodes(tmp_path):
    folder = ResultsFolder(tmp_path / "new")
    assert ran([], ["ours"], folder) == []
    assert gather([], []).methods == ()


def test_each_method_does_its_own_task():
    made = run_methods(episode(PAST), methods_of(RULES), RULES)
    assert "llm_tg" not in made
    assert not any(one.refused for one in made.values())
    ways = {name: one.path_m for name, one in made.items()}
    over = {name: way[:, 1].max() for name, way in ways.items()}
    assert min(over[name] for name in ("ours", "ours, not refined", "vlt_code")) > 1.2
    ends = np.array([way[-1] for way in ways.values()])
    assert np.ptp(ends, axis=0).max() < 1.0
    # A* takes the shortest way round the van; without a map a way is straight from point to point.
    lengths = {name: np.hypot(*np.diff(way, axis=0).T).sum() for name, way in ways.items()}
    assert lengths["a_star"] < lengths["ours"] + 0.1
    turns = np.diff(np.unwrap(np.arctan2(*np.diff(ways["vlt_code"], axis=0).T[::-1])))
    assert (np.abs(turns) > 1e-6).sum() <= 6


def test_a_refusal_is_a_failure_and_the_robot_stays(tmp_path):
    folder = ResultsFolder(tmp_path)
    there = episode("go to the elephant", to_m=(0.5, 0.0))
    for outcome in ran([there], list(methods_of(RULES)), folder):
        assert (outcome.success, outcome.refused) == (False, "not understood")
        assert not outcome.at_thing
        assert outcome.path == [[0.0, 0.0]]
        assert outcome.error_m == pytest.approx(0.5)
        assert "elephant" in outcome.reason


def test_an_end_on_another_side_counts_as_at_the_object(tmp_path):
    there = episode("go to the van", to_m=(8.0, 1.6))
    (outcome,) = ran([there], ["ours"], ResultsFolder(tmp_path))
    assert (outcome.success, outcome.at_thing, outcome.true_depth_m) == (False, True, 0.0)


def test_finished_episodes_are_not_run_again(tmp_path, monkeypatch):
    first = ran([episode(PAST)], ["ours"], ResultsFolder(tmp_path))
    text = (tmp_path / "outcomes.jsonl").read_bytes()
    (tmp_path / "outcomes.jsonl").write_bytes(text + b'{"episode": "bro')
    monkeypatch.setattr("edge.lab.eval.trajectories.run.run_methods", None)
    assert ran([episode(PAST)], ["ours"], ResultsFolder(tmp_path)) == first
    assert (tmp_path / "outcomes.jsonl").read_bytes() == text


def test_numbers_that_are_not_finite_are_not_written(tmp_path):
    folder = ResultsFolder(tmp_path)
    (outcome,) = ran([episode(PAST)], ["ours"], folder)
    before = (tmp_path / "outcomes.jsonl").read_bytes()
    for value in (math.nan, math.inf):
        with pytest.raises(ValueError, match="not JSON compliant"):
            folder.append(replace(outcome, frechet_m=value))
    assert (tmp_path / "outcomes.jsonl").read_bytes() == before


def test_a_crash_is_reported_and_run_again(tmp_path, monkeypatch):
    def broken(*args, **options):
        raise RuntimeError("a bug\nof two lines")

    with monkeypatch.context() as patched:
        patched.setattr(methods, "write_trajectory", broken)
        (outcome,) = ran([episode(PAST)], ["ours"], ResultsFolder(tmp_path))
    assert (outcome.refused, outcome.success) == ("crashed", False)
    assert "\n" not in outcome.reason
    (outcome,) = ran([episode(PAST)], ["ours"], ResultsFolder(tmp_path))
    assert outcome.refused == ""


def test_a_model_writes_with_a_picture_and_without(tmp_path):
    with serving(saying(SCRIPT)) as server:
        config = TasksConfig(planner=WriterModel(url=server.url, model="small"))
        found = ran([episode("go to the gate")], list(METHODS), ResultsFolder(tmp_path), config)
        asked = [request["messages"][1]["content"] for _, _, request in server.requests]
    (writer,) = {outcome.writer for outcome in found}
    assert writer.startswith("small ")
    assert [outcome.refused for outcome in found] == [""] * len(METHODS)
    # Ours, without a picture, without a map: a question that two methods share is asked once.
    assert sorted(isinstance(content, str) for content in asked) == [False, False, True]


def test_outcomes_of_other_settings_are_not_used_again(tmp_path, monkeypatch):
    with serving(saying(SCRIPT)) as server:
        known = []
        for attempts in (2, 3, 3):
            planner = WriterModel(url=server.url, model="small", max_attempts=attempts)
            config = TasksConfig(planner=planner)
            ran([episode("go to the gate")], ["ours"], ResultsFolder(tmp_path), config)
            known.append(len(ResultsFolder(tmp_path).outcomes))
    assert known == [1, 2, 2]
    names = []
    monkeypatch.setattr(
        trajectory_run, "detector_pipeline", lambda *_: nullcontext((None, "model"))
    )
    for tau in (0.3, 0.4, 0.4):
        path = tmp_path / "detector.yaml"
        path.write_text(f"perception: {{detector: {{kind: onnx}}, tau_det: {tau}}}")
        with trajectory_run._detector(SimpleNamespace(detector=str(path))) as (_, name):
            names.append(name)
    assert names[0] != names[1] == names[2]
    assert names[0].startswith("model ")


def test_a_late_answer_counts_as_a_failure(tmp_path):
    with serving(lambda handler: server.stopping.wait(20.0)) as server:
        config = TasksConfig(planner=WriterModel(url=server.url, time_limit_s=0.2))
        (outcome,) = ran([episode(PAST)], ["ours"], ResultsFolder(tmp_path), config)
    assert (outcome.refused, outcome.success) == ("too late", False)
    assert "no complete answer within 0.2 s" in outcome.reason


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("", "no such place"),
        ("streets", "forms: streets"),
        ("streets[5:5]", "got 0 streets"),
        ("kitti:", "no such place"),
        ("kitti:/nowhere", "no frame with image_2/"),
        ("house:/nowhere.yaml", "nowhere.yaml"),
    ],
)
def test_unknown_places_are_reported_in_one_line(spec, words):
    with pytest.raises(UserError, match=words) as caught:
        next(episodes(["streets[0:1]", spec]))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--methods", "our"], "no method 'our' (choices: ours; "),
        (["--methods", "llm_tg"], "without --url this is the same as ours"),
        (["--model", "x"], "give the URL of the model's server"),
        (["--url", "nonsense"], "not the URL of a chat server"),
        (["--detector", "street"], "(sim) sees nothing in a real picture"),
    ],
)
def test_options_that_are_wrong_are_reported_in_one_line(tmp_path, capsys, options, words):
    command = ["eval", "trajectories", "streets[0:1]", "--out", str(tmp_path), *options]
    assert main(command) != 0
    output = capsys.readouterr().err
    assert words in output
    assert output.count("\n") == 1


def test_a_place_that_is_known_is_seen_by_no_detector():
    with pytest.raises(UserError, match="--detector works only with kitti:FOLDER"):
        next(episodes(["streets[0:1]"], pipeline=object()))


def test_the_command(tmp_path, capsys):
    out = tmp_path / "out"
    command = ["eval", "trajectories", "streets[1:3]", "--out", str(out)]
    assert main([*command, "--limit", "1"]) == 0
    printed = capsys.readouterr().out
    for words in ("OpenNav table I", "OpenNav table II", "a_star", "NE", "episodes.svg"):
        assert words in printed
    lines = (out / "outcomes.jsonl").read_text().splitlines()
    assert [json.loads(line)["method"] for line in lines] == list(methods_of(RULES))
    assert (out / "episodes.svg").read_bytes().startswith(b"<?xml")
    (out / "episodes.svg").unlink()
    (out / "episodes.svg").mkdir()
    with pytest.raises(FileError, match=r"episodes\.svg: .*; the tables above are complete"):
        run(make_parser().parse_args([*command, "--limit", "1"]))
