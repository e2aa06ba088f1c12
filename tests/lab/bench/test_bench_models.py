"""`edge bench --models`: the statistics, the ground truth, and the command with tiny models."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import sys

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from onnx_text import tiny_detector

from edge import config
from edge.cli import main as cli
from edge.errors import UserError
from edge.geometry import invert
from edge.host import resources
from edge.lab.bench import compare, frames, isolated, measure, report, variants
from edge.lab.bench.boxes import (
    KIND_OF_PROMPT,
    SAME_NAME,
    UNRELATED,
    DetectedBoxes,
    GroundTruthBoxes,
    Tally,
    agreement,
    match_to_reference,
    match_to_truth,
)
from edge.lab.sim.sensors import CameraRig
from edge.lab.sim.worlds import load_world
from edge.perception.runtime.cards import load_detector_card

SOFA, CHAIR = [0, 0, 40, 40], [60, 60, 80, 100]


def boxes(*rows):
    return np.array(rows, np.float32).reshape(-1, 4)


def found(*rows):
    """Rows of box, score, prompt."""
    return DetectedBoxes(
        boxes(*(row[0] for row in rows)),
        np.array([row[1] for row in rows], np.float32),
        np.array([row[2] for row in rows], np.int32),
    )


def truth(*rows):
    """Rows of box, label, whether it counts."""
    return GroundTruthBoxes(
        boxes(*(row[0] for row in rows)),
        np.array([row[1] for row in rows], np.int32),
        np.array([row[2] for row in rows], bool),
    )


# -- statistics -------------------------------------------------------------------------------


def test_nothing_wanted_and_nothing_found():
    empty = Tally()
    assert empty.shares() == {"recall": None, "precision": None}
    assert match_to_truth(boxes(), truth(), np.array([SAME_NAME])) == empty
    assert match_to_reference(found(), found()) == empty
    assert agreement([], []) == {
        "recall": None, "precision": None, "score_error": None, "boxes": 0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("there", "answers", "boxes_found", "wanted_found_hits"),
    [
        ([], [SAME_NAME], [SOFA], (0, 1, 0)),
        ([(SOFA, 0, True)], [SAME_NAME], [SOFA], (1, 1, 1)),
        ([(SOFA, 0, True)], [SAME_NAME], [SOFA, [1, 1, 41, 41]], (1, 2, 1)),  # once only
        ([(SOFA, 0, True)], [SAME_NAME], [[0, 0, 40, 20]], (1, 1, 1)),
        ([(SOFA, 0, True)], [KIND_OF_PROMPT], [SOFA], (0, 0, 0)),  # an armchair, asked for a chair
        ([(SOFA, 0, False)], [SAME_NAME], [[10, 10, 20, 20]], (0, 0, 0)),  # is in it
        ([(SOFA, 0, False)], [UNRELATED], [SOFA], (0, 1, 0)),
        ([(SOFA, 0, True), (CHAIR, 0, True)], [SAME_NAME], [CHAIR, SOFA], (2, 2, 2)),
    ],
)
def test_boxes_are_matched_to_the_ground_truth(there, answers, boxes_found, wanted_found_hits):
    tally = match_to_truth(boxes(*boxes_found), truth(*there), np.array(answers, np.uint8))
    assert (tally.wanted, tally.found, tally.hits) == wanted_found_hits


@pytest.mark.parametrize(
    ("reference", "candidate", "wanted_found_hits", "error"),
    [
        ([], [(SOFA, 0.5, 0)], (0, 1, 0), None),
        ([(SOFA, 0.5, 0)], [], (1, 0, 0), None),
        ([(SOFA, 0.5, 0)], [(SOFA, 0.4, 0)], (1, 1, 1), 0.2),
        ([(SOFA, 0.5, 0)], [(SOFA, 0.5, 1)], (1, 1, 0), None),
        ([(SOFA, 0.5, 0)], [(SOFA, 0.6, 0), (SOFA, 0.5, 0)], (1, 2, 1), 0.2),
        ([(SOFA, 0.5, 0), (CHAIR, 0.4, 0)], [(CHAIR, 0.4, 0), (SOFA, 0.3, 0)], (2, 2, 2), 0.2),
    ],
)
def test_boxes_against_those_of_another_model(reference, candidate, wanted_found_hits, error):
    tally = match_to_reference(found(*reference), found(*candidate))
    assert (tally.wanted, tally.found, tally.hits) == wanted_found_hits
    assert agreement([found(*reference)], [found(*candidate)])["score_error"] == error


@st.composite
def pictures(draw):
    """Return some boxes of three prompts, best first."""
    corner, side = st.integers(0, 90), st.integers(1, 60)
    rows = draw(st.lists(st.tuples(corner, corner, side, side), max_size=8))
    scores = sorted((draw(st.floats(0.1, 1.0)) for _ in rows), reverse=True)
    labels = [draw(st.integers(0, 2)) for _ in rows]
    return found(
        *(
            ([x, y, x + w, y + h], score, label)
            for (x, y, w, h), score, label in zip(rows, scores, labels, strict=True)
        )
    )


@given(pictures(), pictures())
def test_agreement_is_complete_with_itself_and_bounded(one, other):
    same = match_to_reference(one, one)
    assert (same.hits, same.error) == (len(one.score), 0.0)
    tally = match_to_reference(one, other)
    assert 0 <= tally.hits <= min(tally.wanted, tally.found)


@given(pictures(), pictures(), st.lists(st.booleans(), min_size=8, max_size=8))
def test_uncounted_objects_never_lower_a_score(seen, there, counts):
    """Recall keeps to its objects; precision can only rise when some region is left out."""
    how = np.array([SAME_NAME, UNRELATED, UNRELATED], np.uint8)
    mine = seen.xyxy_px[seen.class_id == 0]
    all_count = GroundTruthBoxes(there.xyxy_px, there.class_id, np.ones(len(there.score), bool))
    only = np.array(counts[: len(there.score)], bool)
    some = GroundTruthBoxes(
        there.xyxy_px[only], there.class_id[only], np.ones(int(only.sum()), bool)
    )
    spared = match_to_truth(mine, GroundTruthBoxes(there.xyxy_px, there.class_id, only), how)
    without = match_to_truth(mine, some, how)
    assert (spared.wanted, spared.hits) == (without.wanted, without.hits)
    assert spared.hits <= spared.found <= without.found == len(mine)
    assert match_to_truth(mine, all_count, how).found == len(mine)


def test_latencies_of_the_stages_and_of_all_together():
    ns = np.array([[1, 10, 2], [3, 30, 2], [2, 20, 2]]) * 1_000_000
    times = compare.latency_ms(ns)
    assert list(times) == ["pre", "session", "post", "all"]
    assert times["session"] == {"min": 10.0, "p50": 20.0, "p95": 29.0}
    assert times["all"]["p50"] == 24.0


# -- frames -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def demo():
    return config.load("demo", environ={})


def test_frames_of_a_world_are_repeatable(demo):
    small = frames.from_world(demo, 3, [(64, 64)])
    camera = demo.sensors.camera
    assert small.rgb[0].shape == (camera.height_px, camera.width_px, 3)
    again = frames.from_world(demo, 3, [(64, 64)])
    assert all(np.array_equal(a, b) for a, b in zip(small.rgb, again.rgb, strict=True))
    large = frames.from_world(demo, 3, [(64, 64), (480, 640)])
    assert large.rgb[0].shape[0] == 480
    # The same objects count, but for those at the very limit.
    assert abs(large.counted - small.counted) <= 2
    assert small.counted > 0


def test_only_whole_visible_objects_count(demo):
    world, camera = load_world(demo), demo.sensors.camera
    rig = CameraRig(demo, world)
    for pose, real in zip(
        frames.free_poses(world, 4, frames.SEED, demo.robot.radius_m),
        frames.from_world(demo, 4, []).truth,
        strict=True,
    ):
        rig.look(pose)
        at_edge = (real.xyxy_px[:, :2] == 0).all(axis=1)
        assert (real.xyxy_px <= [camera.width_px, camera.height_px] * 2).all()
        side = real.xyxy_px[:, 2:] - real.xyxy_px[:, :2]
        assert (side[real.counts].min(axis=1) >= frames.MIN_SIDE_PX).all()
        T_camera_map = invert(pose.matrix() @ rig.T_base_camera)
        whole = [frames.full_area_px(item, T_camera_map, rig) for item in world.objects]
        shown = {int(i) - 1 for i in np.unique(rig.ids)} - {-1}
        assert len(shown) == len(real.label)
        for k, row in zip(sorted(shown), range(len(real.label)), strict=True):
            if real.counts[row]:
                assert side[row].prod() >= frames.MIN_VISIBLE * whole[k]
        assert not (at_edge & (side.prod(axis=1) < 100) & real.counts).any()


def test_frames_of_a_folder(tmp_path):
    with pytest.raises(UserError, match="no images"):
        frames.from_folder(tmp_path, 5)
    for name in ("b.png", "a.jpg"):
        cv2.imwrite(str(tmp_path / name), np.full((20, 30, 3), (0, 0, 255), np.uint8))
    got = frames.from_folder(tmp_path, 1)
    assert (len(got.rgb), got.truth) == (1, None)
    assert got.rgb[0][0, 0].tolist() == pytest.approx([254, 0, 0], abs=2)
    (tmp_path / "0.png").write_bytes(b"no picture")
    with pytest.raises(UserError, match=r"0\.png: not a readable image"):
        frames.from_folder(tmp_path, 5)


# -- the command ------------------------------------------------------------------------------

WORDS = ["chair", "sofa", "bed", "television", "trash can"]
MEASURE = """
import atexit, gc, os, signal, sys
from pathlib import Path
from edge.host import resources
atexit.register(gc.freeze)  # as `edge.host.children` does
resources.data_dir = lambda kind: Path({folder!r})
from edge.lab.bench import isolated, measure
if b"tiny-crash" in Path(sys.argv[1]).read_bytes():
    os.kill(os.getpid(), signal.SIGSEGV)
sys.exit(isolated.main(sys.argv[1:], measure.measure))
"""


def model_bytes(bias):
    """Constant boxes; scores = sigmoid(bias + 3 if the prompt is the box's)."""
    logits = np.full((2, 16), bias, np.float32)
    logits[[0, 1], [0, 1]] += 3.0
    return tiny_detector(boxes(SOFA, [40, 40, 64, 64])[None], logits)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """put(name, content, precision): a card, and its file unless content is None."""
    pytest.importorskip("onnxruntime")
    folder = tmp_path / "cards"
    folder.mkdir()
    ready = resources.data_dir("config")
    monkeypatch.setattr(resources, "data_dir", lambda kind: ready if kind == "config" else folder)
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("EDGE_VOCABULARY", str(tmp_path / "words.npz"))
    monkeypatch.setattr(cli, "setup", lambda *_: None)
    np.savez(tmp_path / "words.npz", names=np.array(WORDS), emb=np.eye(len(WORDS), 16))
    program = tmp_path / "measure.py"
    program.write_text(MEASURE.format(folder=str(folder)))
    monkeypatch.setattr(isolated, "python_module", lambda name: (sys.executable, str(program)))
    resources.models_dir().mkdir(parents=True)

    def put(name, content, precision="fp32", task="detect"):
        card = {
            "name": name, "family": "tiny", "task": task, "file": f"{name}.onnx",
            "sha256": hashlib.sha256(content or b"").hexdigest(), "sources": [], "license": "x",
            "input": {"height": 64, "width": 64}, "precision": precision, "derived_from": None,
            "preprocess": {"color": "rgb", "scale": 1 / 255, "letterbox_pad": 114},
            "text_dim": 16, "parity": None,
        }  # fmt: skip
        (folder / f"{name}.yaml").write_text("# A remark.\n" + yaml.safe_dump(card))
        if content is not None:
            (resources.models_dir() / f"{name}.onnx").write_bytes(content)

    return put


def bench(*words):
    return cli.main(["bench", "--models", *words, "--frames", "2"])


def test_an_unknown_family_lists_the_known_ones(place, capsys, tmp_path):
    simulated = tmp_path / "simulated.yaml"
    simulated.write_text("perception: {detector: {kind: sim}}")
    assert bench("tiny") == os.EX_DATAERR
    assert "'tiny' (choices: none)" in capsys.readouterr().err
    place("tiny-fp32", None)
    assert bench("other", "demo") == os.EX_DATAERR
    assert "'other' (choices: tiny)" in capsys.readouterr().err
    words = ["bench", str(simulated), "--models"]
    assert cli.main(words) == os.EX_DATAERR  # its detector is no model
    assert "give --models a family (choices: tiny)" in capsys.readouterr().err
    assert bench("tiny", "--providers", "cpu,tpu") == os.EX_DATAERR
    assert "'tpu' is not available on this machine (choices: cpu" in capsys.readouterr().err


def test_if_no_model_runs_each_row_gives_the_reason(place, capsys):
    place("tiny-fp32", None)
    place("tiny-fp16", b"no model", "fp16")
    assert bench("tiny", "--providers", "cpu", "demo") == 1
    out = capsys.readouterr().out
    assert "not here: run `edge models export tiny-fp32`" in out
    assert "failed: " in out
    assert "tiny-fp16.onnx: " in out
    assert "Traceback" not in out


def test_every_variant_has_its_own_row(place, tmp_path, capsys):
    place("tiny-fp32", model_bytes(-1.0))
    place("tiny-crash", model_bytes(0.0), "fp16")
    place("tiny-int8-cpu", model_bytes(-1.5), "int8-cpu")
    place("tiny-int8-trt", None, "int8-trt")
    kept = tmp_path / "out" / "figures.json"
    options = ("demo", "--json", str(kept), "--threads", "1")
    assert bench("tiny", *options, "--providers", "cpu") == 0
    kept_report = json.loads(kept.read_text())
    fp32, crashed, int8, missing = kept_report["rows"]
    assert [row["state"] for row in kept_report["rows"]] == ["ran", "failed", "ran", "missing"]
    assert crashed["why"] == "failed: its process was ended by signal 11"
    assert missing["why"].startswith("not here: run `edge models export tiny-int8-trt`")
    assert kept_report["machine"]["cores"] >= 1
    assert kept_report["frames"]["count"] == 2
    assert kept_report["prompts"] == ["bed", "chair", "sofa", "television", "trash can"]
    assert "wardrobe" in kept_report["unknown_labels"]
    for row in (fp32, int8):
        assert row["latency_ms"]["session"]["min"] > 0.0
        assert row["latency_ms"]["all"]["p50"] >= row["latency_ms"]["session"]["min"]
        assert row["truth"]["things"] == kept_report["rows"][0]["truth"]["things"]
        assert row["truth"]["boxes"] <= 4  # two frames with a chair and a sofa each
    assert fp32["agreement"] is None
    assert int8["agreement"]["boxes"] == 4
    assert (int8["agreement"]["recall"], int8["agreement"]["precision"]) == (1.0, 1.0)
    sure, less_sure = 1 / (1 + np.exp(-2.0)), 1 / (1 + np.exp(-1.5))
    assert int8["agreement"]["score_error"] == pytest.approx(1 - less_sure / sure, abs=1e-3)

    out = capsys.readouterr().out
    assert max(map(len, out.split("saved to")[0].splitlines()[:8])) <= 120
    assert "crash" in out
    (own,) = (resources.cache_dir() / "bench").iterdir()
    assert own.name.startswith("tiny-20")
    assert json.loads(own.read_text()) == kept_report


def test_a_folder_of_images_gives_no_truth(place, tmp_path, capsys):
    place("tiny-fp32", model_bytes(-1.0))
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((64, 64, 3), np.uint8))
    kept = tmp_path / "figures.json"
    assert bench("tiny", "--images", str(tmp_path), "--json", str(kept)) == 0
    kept_report = json.loads(kept.read_text())
    assert kept_report["rows"][0]["truth"] is None
    assert kept_report["prompts"] == [w for w in frames.names.ALIASES if w in WORDS]
    assert str(kept) in capsys.readouterr().out


def test_a_variant_that_hangs_is_ended(place, tmp_path, monkeypatch):
    place("tiny-fp32", b"x")
    (tmp_path / "measure.py").write_text("import time; time.sleep(1000)")
    one = variants.Variant(load_detector_card("tiny-fp32"), "cpu")
    job = measure.DetectorJob(config.DetectorOnnx(), [], [], 0.3)
    assert compare.measure_variant(one, job, 0.3).startswith("failed: not done after 0.3 s (")


REPORT = {
    "date": "2026-01-02T03:04:05", "prompts": ["a"], "tau_det": 0.3, "threads": 2,
    "frames": {"count": 2, "hw": [(64, 64)], "source": "x"},
    "machine": {"cpu": "x", "cores": 2, "onnxruntime": "1.23.0", "tensorrt": "10.3.0"},
}  # fmt: skip
ROW = {
    "name": "tiny-fp32", "on": "cpu", "gpu": None, "state": "ran", "sha256": "0" * 64,
    "memory_mb": 1.0, "gpu_memory_mb": None, "others_cores": None, "agreement": None,
    "truth": None, "latency_ms": compare.latency_ms(np.full((2, 3), 1_000_000)),
}  # fmt: skip


@pytest.mark.parametrize(
    ("on", "name"),
    [("cpu", None), ("cuda", "GPU 3"), ("ort-tensorrt", "GPU 3"), ("tensorrt", "GPU 3")],
)
def test_the_process_reports_which_gpu_it_used(monkeypatch, on, name):
    monkeypatch.setattr(measure, "gpu_of", lambda device_id: (f"GPU {device_id}", "8.7"))
    settings = config.DetectorOnnx(providers=variants.PROVIDERS[on], device_id=3)
    assert measure.used_gpu(settings) == name


def test_the_table_has_a_line_for_each_footnote():
    frames_of = {**REPORT["frames"], "things": None}
    row = {**ROW, "on": "cuda", "memory_mb": 100.0, "gpu_memory_mb": 512.0, "others_cores": 1.5}
    compared = {
        **REPORT, "family": "tiny", "frames": frames_of, "unknown_labels": (),
        "rows": [{**row, "invalid_boxes": 3}],
    }  # fmt: skip
    text = report.as_text(compared)
    assert "100+512" in text
    assert "up to 1.5 of 2 cores busy" in text
    assert "tiny-fp32 on cuda: 3 boxes not finite" in text


@pytest.mark.parametrize(
    ("asked", "names"),
    [
        (None, ["cpu", "cuda", "ort-tensorrt", "tensorrt"]),
        ("cuda,cpu", ["cuda", "cpu"]),
        ("tensorrt, cpu", ["tensorrt", "cpu"]),
    ],
)
def test_providers_by_their_names(monkeypatch, asked, names):
    every = {name for providers in variants.PROVIDERS.values() for name in providers}
    monkeypatch.setattr(variants, "_available", lambda: every)
    assert variants.providers_here(asked) == names


def test_without_a_runtime_the_error_names_the_package(monkeypatch):
    monkeypatch.setattr(variants, "_available", set)
    with pytest.raises(UserError, match="pip install"):
        variants.providers_here(None)


def test_any_error_in_the_process_is_one_line(monkeypatch, tmp_path, capsys):
    def fail(job):
        raise RuntimeError("two\nlines")

    monkeypatch.setattr(isolated, "setup", lambda *_: None)
    (tmp_path / "job").write_bytes(pickle.dumps("x"))
    assert isolated.main([str(tmp_path / "job"), str(tmp_path / "out")], fail) == 1
    assert capsys.readouterr().out == "RuntimeError: two lines\n"
