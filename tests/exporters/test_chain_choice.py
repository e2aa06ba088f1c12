"""A model that chooses directions, from its published folder to the service, by commands."""

from __future__ import annotations

import http.server
import os
import re
import shutil
import threading
from functools import partial

import cv2
import numpy as np
import pytest
import yaml

pytest.importorskip("torch", reason="torch is not installed (extra `transformers`)")
pytest.importorskip("transformers", reason="transformers is not installed (extra `transformers`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")
pytest.importorskip("onnxscript", reason="onnxscript is not installed (extra `transformers`)")

import tiny_folders
from edge_processes import edge, endpoint, write_config

__all__ = ["edge", "endpoint"]
pytestmark = [pytest.mark.export, pytest.mark.timeout(900)]


@pytest.fixture
def serve(monkeypatch):
    """Serve a folder; yield its address."""
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    servers = []

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    def start(folder) -> str:
        made = http.server.ThreadingHTTPServer(
            ("127.0.0.1", 0), partial(Quiet, directory=str(folder))
        )
        servers.append(made)
        threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02}).start()
        return f"http://127.0.0.1:{made.server_port}"

    yield start
    for made in servers:
        made.shutdown()
        made.server_close()


@pytest.fixture
def pictures(tmp_path):
    """Return a folder of noise images in a few sizes."""
    random, folder = np.random.default_rng(0), tmp_path / "pictures"
    folder.mkdir()
    for k in range(8):
        cv2.imwrite(str(folder / f"{k}.png"), random.integers(0, 255, (48 + 8 * k, 96, 3)))
    return folder


@pytest.mark.parametrize("kind", ["idefics3", "qwen2_vl"])
def test_from_a_published_folder_to_the_running_service(
    edge, endpoint, serve, pictures, tmp_path, kind
):
    published = tiny_folders.write_vlm(tmp_path / "published", kind)
    desk, robot = tmp_path / "desk" / "models", tmp_path / "robot" / "models"
    robot.mkdir(parents=True)

    def says(where, *words, code=os.EX_OK, of="models"):
        process = edge(of, *words, EDGE_CACHE_DIR=str(where.parent))
        assert process.wait() == code, process.output
        return process.output

    says(desk, "export", "my-vlm", "--weights", published)
    shutil.copy(desk / "my-vlm-fp32.yaml", robot)
    assert "run `edge models pull" in says(robot, "list", "--check", "my-vlm-fp32", code=1)
    pulled = says(robot, "pull", "my-vlm-fp32", "--from", serve(desk / "my-vlm"))
    card = yaml.safe_load((robot / "my-vlm-fp32.yaml").read_text())
    assert pulled.count("from now on") == 3 + len(card["others"])
    assert "my-vlm-fp32: ok (hashes of " in says(robot, "list", "--check", "my-vlm-fp32")

    how = ["--calibration", pictures, "--no-gate"]
    content = says(robot, "export", "--quantize", "my-vlm-fp32", "--precision", "q4", "int8", *how)
    assert "my-vlm-q4 against my-vlm-fp32:" in content
    made = yaml.safe_load((robot / "my-vlm-q4.yaml").read_text())
    assert made["derived_from"] == "my-vlm-fp32"
    assert made["decoder"] == {"file": "quantized/decoder_model_merged_q4.onnx"}
    figures = made["measured"]["against my-vlm-fp32"]
    assert figures["questions"] == 6  # two pictures held out, three targets
    assert figures["cosine"] > 0.99
    assert figures["share_error"] < 0.3
    whole, small = (robot / "my-vlm" / some["decoder"]["file"] for some in (card, made))
    assert small.stat().st_size < 0.7 * whole.stat().st_size
    assert "my-vlm-q4: ok (hashes of " in says(robot, "list", "--check", "my-vlm-q4")
    assert "my-vlm-int8: ok (hashes of " in says(robot, "list", "--check", "my-vlm-int8")

    bench = ["--images", pictures, "--frames", "2", "--threads", "1", "--providers", "cpu"]
    table = says(robot, "--models", "my-vlm", *bench, of="bench")
    for name in ("my-vlm-fp32", "my-vlm-q4", "my-vlm-int8"):
        assert re.search(rf"^{name} +cpu +\d", table, re.MULTILINE), table

    choice = {"kind": "onnx", "card": "my-vlm-fp32", "threads": 1, "time_limit_s": 60}
    perception = {"detector": {"kind": "sim"}, "choice": choice}
    config = write_config(tmp_path, zenoh={"endpoint": endpoint}, perception=perception)
    edge("sim", config)
    run = edge("run", config, EDGE_CACHE_DIR=str(robot.parent)).says("ready:")
    used = says(robot, "use", "my-vlm-q4", config)
    assert "kept: " in used
    assert f"perception.choice.card: my-vlm-q4 in {config}" in used
    assert run.process.poll() is None


def test_an_unsuitable_model_is_refused_in_one_line(edge, pictures, tmp_path):
    """Each before anything is read of a model."""
    models = tmp_path / "models"
    models.mkdir()
    published = tiny_folders.write_vlm(tmp_path / "published", "idefics3")
    words = ("export", "my-vlm", "--weights", published)
    own = {"EDGE_CACHE_DIR": str(tmp_path)}
    assert edge("models", *words, **own).wait() == os.EX_OK
    card = yaml.safe_load((models / "my-vlm-fp32.yaml").read_text())
    (models / "my-vlm-int8.yaml").write_text(yaml.safe_dump({**card, "name": "my-vlm-int8"}))
    other = {**card, "name": "my-vlm-fp16", "precision": "fp16"}
    (models / "my-vlm-fp16.yaml").write_text(yaml.safe_dump(other))
    blind = {**card, "name": "blind-fp32", "vision_encoder": None, "embed_tokens": None}
    (models / "blind-fp32.yaml").write_text(yaml.safe_dump(blind))
    for name, precision, why in [
        ("my-vlm-fp32", "q5", "--precision: no precision 'q5' (choices: int8, q4)"),
        (
            "my-vlm-fp32",
            "int8",
            "model my-vlm-int8: a card has this name already, and is not made from my-vlm",
        ),
        ("my-vlm-fp16", "q4", "model my-vlm-fp16: is fp16; give an FP32 model"),
        ("blind-fp32", "q4", "model blind-fp32: has no vision encoder; give an FP32 model"),
    ]:
        words = ("export", "--quantize", name, "--precision", precision, "--calibration", pictures)
        process = edge("models", *words, **own)
        assert process.wait() == 1, process.output
        assert process.lines[-1].startswith(f"error: {why}"), process.output
    assert not (models / "my-vlm" / "quantized").exists()
