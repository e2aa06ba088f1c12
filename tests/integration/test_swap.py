"""`edge models use` against a service with real ONNX models, over Zenoh."""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import threading
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from edge_processes import write_config
from live_patience import PATIENCE_S
from onnx_text import onnx_of

sys.path.insert(0, str(Path(__file__).parents[1] / "perception"))
from test_perception_cards import CARD

from edge.bus.client import RequestError
from edge.config import load
from edge.geometry import CameraModel
from edge.host import resources
from edge.launch import open_service
from edge.loop.runner import loop
from edge.loop.status import status_message
from edge.models import use
from edge.types import Observation

pytest.importorskip("onnxruntime")

PLACES = ((8, 8, 40, 40), (9, 9, 41, 41), (44, 44, 60, 60))


def detector(shift: float = 0.0, bias: float = 0.0) -> bytes:
    """Write a detector with three boxes in every image, all with score 1 / (1 + exp(-bias))."""
    text = """g (float[1,3,64,64] images, float[1,n,512] txt_feats)
    => (float[1,3,4] boxes, float[1,3,n] scores) {
      darkest = ReduceMin <keepdims = 0> (images)
      nothing = Mul (zero, darkest)
      boxes = Add (box, nothing)
      text = Transpose <perm = [0, 2, 1]> (txt_feats)
      flat = MatMul (zeros, text)
      raw = Add (flat, bias)
      scores = Sigmoid (raw)
    }"""
    zeros, box = np.zeros((1, 3, 512), np.float32), np.array([PLACES], np.float32)
    box += shift
    return onnx_of(text, zero=np.float32(0), bias=np.float32(bias), box=box, zeros=zeros)


MODELS = {
    "first": detector(),
    "good": detector(shift=1.0, bias=1.0),
    "elsewhere": detector(shift=64.0),
}


@pytest.fixture
def isolation() -> str:
    return "thread"


@pytest.fixture
def config(tmp_path, monkeypatch, endpoint, isolation) -> Path:
    """Write the configuration of `first`, cards and files of all, and a vocabulary of two words."""
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    resources.models_dir().mkdir(parents=True)
    for name, data in MODELS.items():
        card = {**CARD, "name": name, "file": f"{name}.onnx"}
        card["sha256"] = hashlib.sha256(data).hexdigest()
        (resources.models_dir() / f"{name}.yaml").write_text(yaml.safe_dump(card))
        (resources.models_dir() / f"{name}.onnx").write_bytes(data)
    words = tmp_path / "words.npz"
    np.savez(words, names=np.array(["chair", "bed"]), emb=np.eye(2, 512, dtype=np.float16))
    perception = {
        "isolation": isolation,
        "process": {"timeout_s": PATIENCE_S},
        "detector": {"kind": "onnx", "model": "first", "vocabulary": str(words), "threads": 1},
        "swap": {"probation": 10, "budget_ms": 1e5},
    }
    return write_config(
        tmp_path, zenoh={"endpoint": endpoint}, perception=perception, loop={"hz": 100},
        mission={"target": "chair"},
    )  # fmt: skip


class Camera:
    """A source of the same image of greys."""

    epoch, pose, inbox = 0, None, SimpleNamespace(poll=list, overruns=0)

    def __init__(self) -> None:
        self.counters = Counter(received=0, observations=0)

    def poll(self) -> Observation:
        self.counters["observations"] += 1
        n = self.counters["observations"]
        rgb = np.broadcast_to(np.arange(96, 160, dtype=np.uint8)[:, None, None], (64, 64, 3)).copy()
        camera = CameraModel.from_hfov(64, 64, 1.3)
        return Observation(n, n * 200_000_000, np.eye(4), rgb=rgb, camera=camera)

    def close(self) -> None: ...


def asked(config: Path, name: str, force: bool = False, timeout: float = 200.0) -> int | str:
    """Return the exit code of `edge models use`, or its error line."""
    try:
        return use.run(argparse.Namespace(name=name, config=config, force=force, timeout=timeout))
    except RequestError as error:
        return str(error)


def test_models_are_swapped_in_the_running_service(config, capsys):
    settings, stop, seen = load(str(config)), threading.Event(), []
    with ThreadPoolExecutor(1) as pool, open_service(settings, []) as running:
        service, running.source = running.service, Camera()
        job = None

        def each() -> None:
            seen.append(status_message(service.result())["detector"]["model"])
            if job.done():
                stop.set()

        def use_one(name: str, **how) -> tuple[int | str, str]:
            nonlocal job
            stop.clear()
            job = pool.submit(asked, config, name, **how)
            loop(running, stop, each=each)
            return job.result(), capsys.readouterr().out.rpartition("\n")[0]

        code, _ = use_one("nothing")
        assert code.startswith("models: refused: model 'nothing': no such card (choices: ")
        code, said = use_one("elsewhere")
        assert (code, "finds 0 of the " in said, {*seen}) == (1, True, {"first"})
        code, said = use_one("elsewhere", force=True)
        assert (code, seen[-1]) == (0, "elsewhere")
        assert said.endswith(
            "valid until the service stops; to keep it, set perception.detector.model: elsewhere "
            f"in {config}"
        )
        assert use_one("good", force=True)[0] == 0
        assert status_message(service.result())["swap"]["state"] == "kept"
        assert status_message(service.result())["detector"]["model"] == "good"


@pytest.mark.slow
@pytest.mark.parametrize("isolation", ["process"])
def test_an_isolated_model_is_swapped_too(config):
    stop = threading.Event()
    with ThreadPoolExecutor(1) as pool, open_service(load(str(config)), []) as running:
        running.source = Camera()
        job = pool.submit(asked, config, "good")
        loop(running, stop, each=lambda: job.done() and stop.set())
        assert job.result() == 0
        status = status_message(running.service.result())
    assert (status["swap"]["state"], status["detector"]["model"]) == ("kept", "good")


LEFT_BEHIND = """
import atexit, threading, types
from edge.cli import main as cli
from edge.host.interruptible import start_detached_thread

def start_other(name, work):
    threading.Thread(target=work, name=name, daemon=True).start()

def handler(args):
    START("for ever", threading.Event().wait)
    return 3

args = types.SimpleNamespace(log_level="info", log_json=False, handler=handler, trust_cache=False)
cli.make_parser = lambda *_: types.SimpleNamespace(parse_args=lambda argv: args)
atexit.register(print, "cleared up")
raise SystemExit(cli.main([]))
"""


@pytest.mark.parametrize(
    ("start", "output"), [("start_detached_thread", ""), ("start_other", "cleared up\n")]
)
def test_exit_works_while_models_load_or_compile(start, output):
    """onnxruntime aborts the process when the interpreter goes while it loads."""
    done = subprocess.run(
        [sys.executable, "-c", LEFT_BEHIND.replace("START", start)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (3, output)
