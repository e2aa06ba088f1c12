"""`edge trajectory`: one command from a picture, a scan and a sentence to a trajectory."""

from __future__ import annotations

import csv
import json
import os
from functools import cache

import cv2
import numpy as np
import pytest
from chat_server import saying, serving
from made_sequence import write

from edge.cli.main import main
from edge.config import load
from edge.lab.eval.trial.scene_capture import capture_street
from edge.lab.eval.trial.task_run import run_task
from edge.tasks.scene.value_map import closed_cells

PICTURES = ["objects.png", "camera.png", "map.png", "scene.html"]
GOOD = """The red car is the first that det_object gives.
```python
car = det_object("car")[0]
region, end = next(iter(car["nearest_reachable"].items()))
give_trajectory([a_star_plan(robot()["position"], end)], [region], 0.4)
```"""


@cache
def seen():
    return capture_street(3, load("street"))


def trajectory(tmp_path, *args):
    """Run the command; return its exit code and folder."""
    out = tmp_path / "out"
    return main(["trajectory", *args, "--out", str(out)]), out


@pytest.mark.parametrize("words", ["", " \n", "go " * 1000])
def test_without_a_sentence_nothing_is_made(tmp_path, capsys, words):
    code, out = trajectory(tmp_path, "street:3", words)
    assert code == os.EX_DATAERR
    assert capsys.readouterr().err.startswith("the instruction ")
    assert not out.exists()


def test_a_trajectory_leads_to_the_named_object():
    outcome, failed = run_task("go to the red car", seen(), load("street"))
    assert failed is None
    (car,) = outcome.mentioned_objects()
    assert outcome.object_at_end()[0] is car
    assert outcome.object_at_end()[1] < 1.5
    scene, poses = outcome.view.scene, outcome.refined.poses
    assert poses[-1, 3] == outcome.written.coarse.heading_rad, "it looks at the car"
    closed = closed_cells(scene.occupancy, load("street").tasks.trajectory.clearance_m)
    assert not any(closed[scene.occupancy.cell_of(x, y)] for x, y in poses[:, :2])
    np.testing.assert_allclose(poses[:, 2], 0.0, atol=0.05)


def test_the_command_leaves_pictures_page_and_trajectory(tmp_path, capsys):
    code, out = trajectory(tmp_path, "street:3", "go to the red car")
    said = capsys.readouterr().out
    assert code == os.EX_OK
    assert "to car" in said
    assert sorted(path.name for path in out.iterdir()) == sorted(
        [*PICTURES, "trajectory.csv", "trajectory.json"]
    )
    saved = json.loads((out / "trajectory.json").read_text(encoding="utf-8"))
    rows = list(csv.DictReader((out / "trajectory.csv").open(encoding="utf-8")))
    assert len(rows) == len(saved["poses"]) == len(saved["times_s"]) > 20
    assert [float(rows[-1][key]) for key in ("x_m", "y_m", "z_m", "heading_rad")] == (
        saved["poses"][-1]
    )
    assert float(rows[-1]["speed_mps"]) == 0.0
    assert saved["instruction"] == "go to the red car"
    assert saved["frame"] == "map"
    for name in PICTURES[:3]:
        assert cv2.imread(str(out / name)).std() > 10.0
    assert "go to the red car" in (out / "scene.html").read_text(encoding="utf-8")


def test_an_unreachable_goal_is_reported(tmp_path, capsys):
    code, _ = trajectory(tmp_path, "street:3", "go straight for 300 metres")
    assert code == os.EX_DATAERR
    assert "the path straight on is blocked" in capsys.readouterr().err


def test_the_configured_detector_finds_the_named_object(tmp_path, capsys):
    code, _ = trajectory(tmp_path, "street:3", "go to the red car", "--objects", "detector")
    assert code == os.EX_OK
    assert "from the simulated detector" in capsys.readouterr().out


def test_a_detector_works_without_labels(tmp_path, capsys, monkeypatch):
    """The shipped detector finds nothing there; flat cells are ground."""
    folder = write(tmp_path / "sequence", points=20_000)
    (folder / "labels/000000.label").unlink()
    detector = {"kind": "onnx", "model": "mini-house-256x320-int8-cpu", "background": ["chair"]}
    monkeypatch.setenv("EDGE__PERCEPTION__DETECTOR", json.dumps(detector))
    options = "--config", "kitti", "--objects", "detector"
    code, out = trajectory(tmp_path, str(folder), "go straight for 8 metres", *options)
    said = capsys.readouterr()
    assert code == os.EX_OK, said.err
    assert "0 objects from mini-house-256x320-int8-cpu, 1 regions of ground" in said.out
    poses = json.loads((out / "trajectory.json").read_text(encoding="utf-8"))["poses"]
    np.testing.assert_allclose(poses[-1][:2], (8.0, 0.0), atol=0.3)


def test_a_plugin_pipeline_replaces_the_detector(tmp_path, capsys, monkeypatch):
    """It calls the car a mailbox, and says that it is yellow."""
    folder = write(tmp_path / "sequence", points=20_000)
    chain = {"kind": "own_chain:make", "options": {"box": [35, 15, 65, 50]}}
    monkeypatch.setenv("EDGE__TASKS__PIPELINE", json.dumps(chain))
    options = "--config", "kitti", "--objects", "detector"
    code, out = trajectory(tmp_path, str(folder), "go to the mailbox", *options)
    said = capsys.readouterr()
    assert code == os.EX_OK, said.err
    assert "1 objects from own_chain:make" in said.out
    assert "a yellow box, " in said.out
    end = json.loads((out / "trajectory.json").read_text(encoding="utf-8"))["poses"][-1]
    assert np.hypot(end[0] - 10.0, end[1]) < 2.5


@pytest.mark.parametrize(
    ("chain", "line"),
    [
        ({"kind": "mine"}, "tasks.pipeline.kind: expected module:Class"),
        ({"kind": "own_chain:made_of_nothing"}, "own_chain:made_of_nothing is no pipeline"),
        (
            {"kind": "own_chain:make", "options": {"box": [0, 0, 9, 9], "fails": "no\nmemory"}},
            "tasks.pipeline: own_chain:make: boxes() raised RuntimeError: no memory",
        ),
    ],
)
def test_an_unusable_pipeline_is_an_error_of_one_line(tmp_path, capsys, monkeypatch, chain, line):
    folder = write(tmp_path / "sequence")
    monkeypatch.setenv("EDGE__TASKS__PIPELINE", json.dumps(chain))
    options = "--config", "kitti", "--objects", "detector"
    assert trajectory(tmp_path, str(folder), "go to the mailbox", *options)[0] != os.EX_OK
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1


WRONG = {
    "no such place": (["nowhere", "go to the car"], os.EX_DATAERR, "nowhere: no frame with"),
    "no number of a street": (["street:-1", "go to the car"], os.EX_DATAERR,
                              "PLACE: street:-1: expected street:N"),
    "frames of a street": (["street:3", "go to the car", "--frames", "1"], os.EX_DATAERR,
                           "--frames: street:3 has no frames"),
    "no such configuration": (["street:3", "go to the car", "--config", "x.yaml"], os.EX_CONFIG,
                              "x.yaml"),
    "a robot without a LiDAR": (["street:3", "go to the car", "--config", "demo"], os.EX_DATAERR,
                                "sensors.lidar: missing, but street:N needs a LiDAR"),
    "no URL": (["street:3", "go to the car", "--url", "ftp://x"], os.EX_UNAVAILABLE,
               "not the URL of a chat server: 'ftp://x'"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_invalid_input_is_reported_in_one_line(tmp_path, capsys, case):
    args, code, line = WRONG[case]
    assert trajectory(tmp_path, *args)[0] == code
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1


def test_an_unwritable_folder_is_reported_first(tmp_path, capsys):
    (tmp_path / "out").write_text("a file")
    assert trajectory(tmp_path, "nowhere", "go to the car")[0] == os.EX_IOERR
    assert "out: cannot be written: File exists; choose another folder" in capsys.readouterr().err


def test_the_prompt_and_the_answer_of_a_model_are_kept(tmp_path, capsys):
    answers = ("```python\nimport os\n```", GOOD)
    with serving(saying(*answers)) as server:
        code, out = trajectory(
            tmp_path, "street:3", "go to the red car", "--url", server.url, "--model", "m"
        )
        first = server.requests[0][2]
    assert code == os.EX_OK, capsys.readouterr().err
    assert first["model"] == "m"
    text, image = first["messages"][1]["content"]
    prompt = (out / "model/prompt.txt").read_text(encoding="utf-8")
    assert first["messages"][0]["content"] in prompt
    assert text["text"] in prompt
    assert image["image_url"]["url"].startswith("data:image/jpeg")
    assert cv2.imread(str(out / "model/picture.jpg")).shape == (540, 960, 3)
    assert sorted(path.name for path in (out / "model").iterdir()) == [
        "picture.jpg", "prompt.txt", "round-1-answer.txt", "round-1-code.py", "round-1-error.txt",
        "round-2-answer.txt", "round-2-code.py",
    ]  # fmt: skip
    speeds = json.loads((out / "trajectory.json").read_text(encoding="utf-8"))["speeds_mps"]
    assert max(speeds) <= 0.4


def test_a_recorded_street_with_its_frames(tmp_path, capsys, shared_dir):
    """Drive SemanticKITTI 05 to the van behind the pillar; name the folder of a missing frame."""
    folder = str(shared_dir / "logs" / "semantic_kitti_05")
    code, _ = trajectory(tmp_path, folder, "go to the truck", "--frames", "3")
    assert code == os.EX_DATAERR
    assert (
        "no frame 3 with image, scan and labels (choices: 0, 2, 4, 6, 8)" in capsys.readouterr().err
    )
    code, out = trajectory(tmp_path, folder, "go to the truck", "--frames", "0", "2", "4")
    assert code == os.EX_OK
    saved = json.loads((out / "trajectory.json").read_text(encoding="utf-8"))
    assert saved["place"] == "semantic_kitti_05, frames 0, 2, 4"
    assert np.hypot(*(np.array(saved["poses"][-1][:2]) - (36.9, 6.2))) < 3.0
    code, _ = trajectory(tmp_path, folder, "go to the truck", "--objects", "detector")
    assert code == os.EX_DATAERR
    assert "(sim) sees nothing in a real picture" in capsys.readouterr().err
