"""Real servers run the small detector: Triton takes tensors as bytes, MLServer as JSON.

Both come from the package index, into a Python of their own (`.ci/run`): MLServer's dependencies
are not edge's, and the Triton of nvidia-pytriton needs a NumPy before 2.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
import yaml
from live_patience import eventually

from edge import config
from edge.cli.main import main
from edge.host.ports import free_port
from edge.perception.detection.remote import MAX_PAUSE_S, RemoteDetector
from edge.perception.factory import make_detector
from edge.perception.runtime.cards import load_card
from edge.types import Observation

HERE = Path(__file__).resolve().parent
SMALL = "mini-house-256x320-int8-cpu"
PYTHON = Path(os.environ.get("EDGE_KSERVE_PYTHON", HERE.parents[1] / ".venv/kserve/bin/python"))
PROMPTS = ("chair", "bed", "red sofa")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PYTHON.exists(), reason=f"{PYTHON}: no servers here; see .ci/run"),
]

TRITON_CONFIG = """
backend: "python"
max_batch_size: 0
input [
  { name: "images" data_type: TYPE_FP32 dims: [1, 3, 256, 320] },
  { name: "txt_feats" data_type: TYPE_FP32 dims: [1, -1, 64] }
]
output [
  { name: "boxes" data_type: TYPE_FP32 dims: [1, -1, 4] },
  { name: "scores" data_type: TYPE_FP32 dims: [1, -1, -1] }
]
"""
# The wheel has Triton without its onnxruntime backend, and the Python backend's own search path.
TRITON_MODEL = """
import os, sys
sys.path[:0] = [os.environ["SITE"]]
import onnxruntime
import triton_python_backend_utils as backend

class TritonPythonModel:
    def initialize(self, args):
        self.session = onnxruntime.InferenceSession(os.environ["MODEL_FILE"])

    def execute(self, requests):
        def answer(request):
            get = backend.get_input_tensor_by_name
            feed = {n: get(request, n).as_numpy() for n in ("images", "txt_feats")}
            found = self.session.run(["boxes", "scores"], feed)
            tensors = map(backend.Tensor, ("boxes", "scores"), found)
            return backend.InferenceResponse(list(tensors))
        return [answer(request) for request in requests]
"""
MLSERVER_MODEL = """
import os
import onnxruntime
from mlserver import MLModel
from mlserver.codecs import NumpyCodec
from mlserver.types import InferenceResponse

class Small(MLModel):
    async def load(self):
        self.session = onnxruntime.InferenceSession(os.environ["MODEL_FILE"])
        return True

    async def predict(self, payload):
        feed = {i.name: NumpyCodec.decode_input(i) for i in payload.inputs}
        found = self.session.run(["boxes", "scores"], feed)
        outputs = [NumpyCodec.encode_output(n, a) for n, a in zip(("boxes", "scores"), found)]
        return InferenceResponse(model_name=self.name, outputs=outputs)
"""


def site() -> str:
    told = [str(PYTHON), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    return subprocess.run(told, capture_output=True, text=True, check=True).stdout.strip()


def triton(folder: Path, port: int) -> list[str]:
    """Return the command that serves the small detector with Triton."""
    root = Path(site()) / "pytriton/tritonserver"
    if not root.exists():
        pytest.skip("nvidia-pytriton is not installed beside MLServer; see .ci/run")
    model = folder / "repository/small"
    (model / "1").mkdir(parents=True)
    (model / "config.pbtxt").write_text(TRITON_CONFIG)
    (model / "1/model.py").write_text(TRITON_MODEL)
    version = ".".join(subprocess.run(
        [str(PYTHON), "-c", "import sys; print(*sys.version_info[:2])"],
        capture_output=True, text=True, check=True,
    ).stdout.split())  # fmt: skip
    backend = folder / "backends/python"
    backend.mkdir(parents=True)
    for file in (root / "backends/python").iterdir():
        (backend / file.name).symlink_to(file)
    stub = root / f"python_backend_stubs/{version}/triton_python_backend_stub"
    if not stub.exists():
        pytest.skip(f"Triton's Python backend has no stub for Python {version}")
    stub.chmod(0o755)  # a wheel forgets it
    (backend / stub.name).symlink_to(stub)
    program = root / "bin/tritonserver"
    program.chmod(0o755)
    return [
        str(program), f"--model-repository={model.parent}", f"--backend-directory={backend.parent}",
        "--http-address=127.0.0.1", f"--http-port={port}", "--allow-grpc=false",
        "--allow-metrics=false",
    ]  # fmt: skip


def mlserver(folder: Path, port: int) -> list[str]:
    """Return the command that serves the small detector with MLServer."""
    (folder / "small").mkdir()
    (folder / "small/small.py").write_text(MLSERVER_MODEL)
    model = {"name": "small", "implementation": "small.Small"}
    (folder / "small/model-settings.json").write_text(json.dumps(model))
    settings = {
        "host": "127.0.0.1", "http_port": port, "grpc_port": free_port(),
        "metrics_port": free_port(), "parallel_workers": 0, "debug": False,
    }  # fmt: skip
    (folder / "settings.json").write_text(json.dumps(settings))
    return [str(PYTHON.with_name("mlserver")), "start", str(folder)]


SERVERS = {"triton": (triton, True), "mlserver": (mlserver, False)}


@contextlib.contextmanager
def served(command: list[str], folder: Path, port: int) -> Iterator[subprocess.Popen]:
    """Run a server until the end of the block; wait until it has the model."""
    environ = {
        **os.environ, "MODEL_FILE": str(load_card(SMALL).path), "SITE": site(),
        "PYTHONPATH": str(folder / "small"),
    }  # fmt: skip
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            command, cwd=folder, env=environ, stdout=log, stderr=log, start_new_session=True
        )
    ready = f"http://127.0.0.1:{port}/v2/models/small/ready"

    def is_ready() -> bool:
        assert process.poll() is None, (folder / "log").read_text()[-2000:]
        time.sleep(0.2)
        with contextlib.suppress(httpx.HTTPError):
            return httpx.get(ready, trust_env=False).status_code == 200
        return False

    try:
        eventually(is_ready, "the server never had its model")
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.fixture(params=SERVERS)
def server(request, tmp_path, monkeypatch):
    """(start it, card `far`, whether it takes bytes)."""
    port, (command, binary) = free_port(), SERVERS[request.param]
    folder = tmp_path / request.param
    folder.mkdir()
    told = command(folder, port)
    (tmp_path / "models").mkdir()
    card = load_card(SMALL).model_dump(mode="json", exclude={"file", "sha256", "measured"})
    where = {"url": f"http://127.0.0.1:{port}", "model": "small", "time_limit_s": 60}
    (tmp_path / "models/far.yaml").write_text(
        yaml.safe_dump({**card, "name": "far", "server": where})
    )
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    return (lambda: served(told, folder, port)), binary


def detector(model: str):
    chosen = config.DetectorOnnx(model=model, tau_vl=1e-6, threads=1)
    return make_detector(config.PerceptionConfig(detector=chosen), PROMPTS)


def test_a_kserve_server_gives_the_same_boxes_and_may_restart(server, capsys):
    start, binary = server
    rgb = np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)
    seen = Observation(0, 0, np.eye(4), rgb=rgb)
    here, there = detector(SMALL), detector("far")
    assert isinstance(there, RemoteDetector)
    wanted = here.detect(seen)

    def found():
        with contextlib.suppress(Exception):
            return there.detect(seen)
        time.sleep(MAX_PAUSE_S / 10)
        return None

    try:
        for _ in range(2):
            assert found() is None  # no server listens yet, or any more
            with start():
                answer = eventually(found, "it was never asked again")
                np.testing.assert_allclose(answer.score, wanted.score, atol=1e-4)
                np.testing.assert_allclose(answer.xyxy_px, wanted.xyxy_px, atol=0.05)
                assert there.health() == ("ok", "")
                assert main(["models", "list", "--check", "far"]) == 0
                assert f"tensors go as {'bytes' if binary else 'JSON'}" in capsys.readouterr().out
            there._next_s = 0.0
            assert found() is None
            assert there.health().state == "degraded"
    finally:
        there.close()
