"""The export of a real card from real weights: inputs, outputs and record of the file."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

pytestmark = [pytest.mark.export, pytest.mark.timeout(600)]

CARDS = Path(__file__).resolve().parents[2] / "models"
NAME = "yolo-world-s-256x320-int8-cpu"


@pytest.fixture(scope="module")
def cache(weights, vocabulary, photos, tmp_path_factory) -> Path:
    """Return a folder with the INT8 card exported from the weights, which takes two minutes.

    $EXPORTED_MODELS names such a folder if there is one already, as in `.ci/run`.
    """
    from exporters.__main__ import main

    if exported := os.environ.get("EXPORTED_MODELS"):
        return Path(exported)
    folder = tmp_path_factory.mktemp("cache")
    arguments = [NAME, "--weights", weights, "--vocabulary", vocabulary, "--cache", folder]
    arguments += ["--calibration", photos, "--no-gate"]
    assert main([str(argument) for argument in arguments]) == 0
    return folder


def session(path: Path):
    import onnxruntime

    return onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])


@pytest.mark.parametrize("name", [NAME, NAME.replace("int8-cpu", "fp32")])
@pytest.mark.parametrize("prompts", [1, 7])
def test_the_contract_of_a_detector(cache, name, prompts):
    text = np.random.default_rng(0).normal(size=(1, prompts, 512)).astype(np.float32)
    text /= np.linalg.norm(text, axis=2, keepdims=True)
    feed = {"images": np.full((1, 3, 256, 320), 0.5, np.float32), "txt_feats": text}
    boxes, scores = session(cache / f"{name}.onnx").run(["boxes", "scores"], feed)
    assert boxes.shape == (1, 1680, 4)
    assert scores.shape == (1, 1680, prompts)
    assert boxes.dtype == scores.dtype == np.float32
    assert (boxes[..., 2:] >= boxes[..., :2]).all()
    assert ((scores >= 0) & (scores <= 1)).all()


def test_the_sidecar_has_the_hash_and_size_of_the_file(cache):
    from exporters.files import sha256_of

    sidecar = json.loads((cache / f"{NAME}.onnx.json").read_text())
    assert sidecar["sha256"] == sha256_of(cache / f"{NAME}.onnx")
    assert sidecar["bytes"] == (cache / f"{NAME}.onnx").stat().st_size
    assert sidecar["tools"]["onnxruntime"]
    assert not list(cache.glob(".*")), "temporary files are gone"


def test_the_parity_is_measured(cache):
    fp32_name = NAME.replace("int8-cpu", "fp32")
    int8, fp32 = (
        json.loads((cache / f"{name}.onnx.json").read_text())["parity"]
        for name in (NAME, fp32_name)
    )
    assert int8["reference"] == fp32_name
    assert int8["images"] >= 1
    assert fp32["recall"] == fp32["precision"] == 1.0


def test_int8_finds_the_same_boxes_as_fp32(cache, photos, vocabulary):
    from exporters.images import list_images, load_text_embeddings
    from exporters.parity import measure

    report = measure(
        cache / f"{NAME.replace('int8-cpu', 'fp32')}.onnx",
        cache / f"{NAME}.onnx",
        list_images(photos),
        load_text_embeddings(vocabulary),
    )
    assert report.detections > 0
    assert report.recall >= 0.8
    assert report.score_error < 0.4


def test_the_export_is_the_same_twice(cache, weights, tmp_path):
    from exporters.files import sha256_of
    from exporters.yolo_world import export_onnx, load_detector

    again = tmp_path / "again.onnx"
    export_onnx(load_detector(weights, sha256_of(weights)), 256, 320, again)
    assert again.read_bytes() == (cache / f"{NAME.replace('int8-cpu', 'fp32')}.onnx").read_bytes()


def test_a_checkpoint_with_a_wrong_hash_is_not_loaded(weights, tmp_path, capsys):
    from exporters.__main__ import main

    false = tmp_path / "weights.pt"
    false.write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    name = NAME.replace("int8-cpu", "fp32")
    assert main([name, "--weights", str(false), "--cache", str(tmp_path)]) == 1
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert "weights.pt: SHA-256 is" in error
    assert "not loaded" in error
    assert not list(tmp_path.glob("*.onnx"))


def test_int8_needs_calibration_images(weights, tmp_path, capsys):
    from exporters.__main__ import main

    assert main([NAME, "--weights", str(weights), "--cache", str(tmp_path)]) == 1
    assert "--calibration is missing" in capsys.readouterr().err


def test_without_a_vocabulary_the_words_inside_the_checkpoint_are_kept(
    weights, vocabulary, tmp_path
):
    from edge.perception.embedding.text import VOCABULARY_FILE, TextEmbeddings
    from exporters.__main__ import main

    name = NAME.replace("int8-cpu", "fp32")
    assert main([name, "--weights", str(weights), "--cache", str(tmp_path)]) == 0
    kept = TextEmbeddings(str(tmp_path / VOCABULARY_FILE))
    ours = TextEmbeddings(str(vocabulary))
    words = ["chair", "bed", "toilet"]
    alike = kept.embed(words)[0] @ ours.embed(words)[0].T
    assert (np.diag(alike) > 0.95).all()
    assert (alike.argmax(1) == range(len(words))).all()


@pytest.fixture
def small(tmp_path, monkeypatch) -> Path:
    """Return a folder with a small network's cards, FP32 file, vocabulary and noise images."""
    for module in ("onnx", "onnxruntime"):
        pytest.importorskip(module)
    import cv2
    import small_net
    import yaml

    monkeypatch.setattr("exporters.__main__.recipe_of", lambda family: small_net.RECIPE)
    random = np.random.default_rng(0)
    for precision in ("fp32", "fp16", "int8-cpu"):
        card = yaml.safe_load((CARDS / f"{NAME}.yaml").read_text()) | {
            "name": precision, "precision": precision, "file": f"{precision}.onnx",
            "derived_from": None if precision == "fp32" else "fp32", "sources": [],
            "input": {"height": 32, "width": 32},
        }  # fmt: skip
        (tmp_path / f"{precision}.yaml").write_text(yaml.safe_dump(card))
    for number in range(8):
        cv2.imwrite(str(tmp_path / f"{number}.png"), random.integers(0, 255, (32, 32, 3)))
    np.savez(tmp_path / "words.npz", names=["sofa", "bed"], emb=random.normal(size=(2, 8)))
    small_net.build(tmp_path / "fp32.onnx")
    return tmp_path


@pytest.mark.parametrize("name", ["fp16", "int8-cpu"])
def test_a_variant_of_an_existing_fp32_needs_no_weights(small, name, capsys, monkeypatch):
    from exporters.__main__ import main

    monkeypatch.setattr("edge.host.progress.LOG_PERIOD_S", 0.0)

    def run(card, *options):
        folders = ["--cache", str(small), "--cards", str(small)]
        return main([card, *folders, "--calibration", str(small), "--no-gate", *options])

    assert run(name) == 1
    assert "--vocabulary is missing" in capsys.readouterr().err
    assert run(name, "--vocabulary", str(small / "words.npz")) == 0
    output, slow = capsys.readouterr().err, {"fp16": "values", "int8-cpu": "histograms"}[name]
    for what, count in (("read", 6), (slow, 6), ("compared", 2)):
        assert re.search(rf"pictures: {what}: 100%.* {count}/{count} ", output)
    parity = json.loads((small / f"{name}.onnx.json").read_text())["parity"]
    assert (parity["reference"], parity["images"]) == ("fp32", 2)
    assert session(small / f"{name}.onnx").get_outputs()[1].name == "scores"
    assert run("fp32") == 1
    assert "--weights is missing" in capsys.readouterr().err
    (small / "fp32.onnx").unlink()
    assert run(name, "--vocabulary", str(small / "words.npz")) == 1
    assert "fp32.onnx: no such file; give --weights" in capsys.readouterr().err
