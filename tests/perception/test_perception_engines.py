"""TensorRT engines: the cache on the real disk; TensorRT and CUDA as fakes (fake_gpu.py).

What rests on a real GPU is in tests/integration/test_gpu_runtime.py.
"""

from __future__ import annotations

import errno
import fcntl
import gc
import json
import logging
import os
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from fake_gpu import FakeCuda, FakeTensorrt, OnnxContext
from patience import PATIENCE_S, eventually
from test_perception_cards import flip_a_byte
from test_perception_onnx import BOXES, tiny  # noqa: F401

from edge import config
from edge.host import resources
from edge.perception.embedding.text import PromptError
from edge.perception.factory import make_detector
from edge.perception.runtime import binding, cuda, engines, tensorrt
from edge.perception.runtime.engines import (
    EngineOptions,
    folder_name,
    get_or_build,
    report_progress,
)
from edge.perception.runtime.model_file import TRUST_CACHE, ModelError
from edge.perception.runtime.sessions import open_session
from edge.perception.runtime.tensorrt import make_monitor

KEY = {"model": "tiny", "sha256": "a" * 64, "sm": "8.7", "gpu": "Orin", "recipe": 1}


class Builds:
    def __init__(self, content=b"engine"):
        self.count, self.content = 0, content

    def __call__(self, folder: Path) -> None:
        self.count += 1
        assert not list(folder.iterdir())
        (folder / "model.engine").write_bytes(self.content)


def quiet(health):
    pass


def test_an_engine_is_built_once(tmp_path):
    build, cache = Builds(), tmp_path / "a" / "engines"
    folder = get_or_build(KEY, cache, build, quiet)
    assert (folder / "model.engine").read_bytes() == b"engine"
    assert folder.stat().st_mode & 0o777 == 0o755
    assert get_or_build(KEY, cache, build, quiet) == folder
    assert build.count == 1
    assert {p.name for p in cache.iterdir()} == {folder.name, f"{folder.name}.lock"}
    assert json.loads((folder / "engine.json").read_text())["key"]["sm"] == "8.7"


@pytest.mark.parametrize(
    "harm",
    [
        lambda folder: (folder / "model.engine").write_bytes(b"engin"),
        lambda folder: (folder / "model.engine").unlink(),
        lambda folder: (folder / "engine.json").write_bytes(b"{"),
        lambda folder: (folder / "engine.json").write_text('{"files": []}'),
        lambda folder: (folder / "engine.json").write_text('{"files": {}}'),
        lambda folder: (folder / "engine.json").unlink(),
    ],
)
def test_a_damaged_engine_is_built_again_with_one_line(tmp_path, caplog, harm):
    build = Builds()
    folder = get_or_build(KEY, tmp_path, build, quiet)
    harm(folder)
    with caplog.at_level(logging.WARNING):
        assert get_or_build(KEY, tmp_path, build, quiet) == folder
    assert build.count == 2
    assert len(caplog.records) == 1
    assert "the engine is built again" in caplog.text
    assert (folder / "model.engine").read_bytes() == b"engine"


def test_an_unremovable_damaged_engine_is_an_error(tmp_path, monkeypatch):
    """The engine may belong to another user, in a folder that is read-only here."""
    build = Builds()
    folder = get_or_build(KEY, tmp_path, build, quiet)
    (folder / "model.engine").write_bytes(b"engin")
    monkeypatch.setattr(engines.shutil, "rmtree", lambda path, ignore_errors: None)
    says = r"unusable \(model.engine is damaged\), and this user cannot .*engine_cache$"
    with pytest.raises(ModelError, match=says):
        get_or_build(KEY, tmp_path, build, quiet)
    assert build.count == 1


def test_a_build_that_fails_or_dies_leaves_nothing_behind(tmp_path):
    def dies(folder):
        (folder / "model.engine").write_bytes(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        get_or_build(KEY, tmp_path, dies, quiet)
    assert [p.name for p in tmp_path.iterdir()] == [f"{folder_name(KEY)}.lock"]
    killed = tmp_path / f".{folder_name(KEY)}.killed"
    killed.mkdir()
    get_or_build(KEY, tmp_path, Builds(), quiet)
    assert not killed.exists()


def test_a_failed_or_unsaved_build_is_an_error(tmp_path):
    with pytest.raises(ModelError, match="the build left no engine"):
        get_or_build(KEY, tmp_path, lambda folder: None, quiet)

    def fills_the_disk(folder):
        raise OSError(28, "No space left on device")

    with pytest.raises(ModelError, match=r"cannot be saved \(No space left"):
        get_or_build(KEY, tmp_path, fills_the_disk, quiet)


def file_in_the_way(path):
    path.write_text("")
    return path


def below_a_file(path):
    path.write_text("")
    return path / "engines"


@pytest.mark.parametrize(
    "place", [file_in_the_way, below_a_file, lambda path: Path("/proc/engines")]
)
def test_an_unusable_cache_fails_before_the_build(tmp_path, place):
    build = Builds()
    with pytest.raises(ModelError, match=r"cannot hold engines .*engine_cache") as error:
        get_or_build(KEY, place(tmp_path / "x"), build, quiet)
    assert build.count == 0
    assert "\n" not in str(error.value)


def test_a_full_cache_is_an_error_before_the_build(tmp_path, monkeypatch):
    usage = type("Usage", (), {"free": 5 << 20})
    monkeypatch.setattr(engines.shutil, "disk_usage", lambda path: usage)
    with pytest.raises(ModelError, match="5 MB free"):
        get_or_build(KEY, tmp_path, Builds(), quiet)


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC])
def test_an_existing_engine_is_found_on_a_read_only_disk(tmp_path, monkeypatch, number):
    folder = get_or_build(KEY, tmp_path, Builds(), quiet)

    def fail(*_, **__):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(engines.tempfile, "NamedTemporaryFile", fail)
    monkeypatch.setattr(engines, "_locked", fail)
    assert get_or_build(KEY, tmp_path, Builds(), quiet) == folder
    (folder / "model.engine").unlink()
    with pytest.raises(ModelError, match="cannot hold engines"):
        get_or_build(KEY, tmp_path, Builds(), quiet)


def test_two_at_once_build_one_engine(tmp_path):
    told, build, results = [], Builds(), []
    with (tmp_path / f"{folder_name(KEY)}.lock").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # as the other process does that builds
        waits = threading.Thread(
            target=lambda: results.append(get_or_build(KEY, tmp_path, build, told.append))
        )
        waits.start()
        eventually(lambda: told, "it did not say that it waits")
        assert "another process builds it" in told[0].detail
        assert not results
        made = tmp_path / folder_name(KEY)
        made.mkdir()
        (made / "model.engine").write_bytes(b"engine")
        engines._seal(made, KEY)
    waits.join(PATIENCE_S)
    assert results == [made]
    assert build.count == 0


def test_a_build_reports_its_progress():
    told = []
    with report_progress("tiny", told.append, every_s=0.001) as note:
        eventually(lambda: told)
        note("45% of building engine")
        eventually(lambda: "45%" in told[-1].detail)
    assert told[0].state == "building engine"
    assert told[0].detail.startswith("tiny: 0 s, ")
    over = len(told)
    assert not [thread for thread in threading.enumerate() if thread.name == "building"]
    assert len(told) == over


def test_progress_covers_nested_build_phases():
    noted = []
    monitor = make_monitor(FakeTensorrt(FakeCuda()), noted.append)
    monitor.phase_start("Building Engine", None, 4)
    monitor.step_complete("Building Engine", 0)
    monitor.phase_start("Timing", "Building Engine", 2)
    monitor.step_complete("Timing", 0)
    monitor.step_complete("No Such", 3)
    monitor.phase_finish("Timing")
    monitor.phase_finish("Building Engine")
    shares = ["0%", "25%", "25%", "38%", "38%", "25%"]
    assert noted == [*(f"{share} of building engine" for share in shares), ""]


@pytest.fixture
def gpu(monkeypatch):
    """Install a fake TensorRT on a fake GPU, for `import`."""
    fake = FakeTensorrt(FakeCuda())
    monkeypatch.setitem(sys.modules, "tensorrt", fake)
    monkeypatch.setattr(cuda, "load", lambda: fake.cuda)
    monkeypatch.setattr(engines, "gpu_of", lambda *_: ("Fake Orin", "8.7"))
    return fake


@pytest.fixture
def open_tiny(tmp_path):
    """open(**options): a session of TensorRT for a model of any number of prompts up to 4."""
    path = tmp_path / "tiny.onnx"
    path.write_bytes(b"model")

    def open_it(progress=quiet, device_id=0):
        shapes = {"txt_feats": ((1, 1, 2), (1, 2, 2), (1, 4, 2))}
        options = EngineOptions("tiny", "fp16", shapes, tmp_path / "engines", progress)
        return open_session(path, ["tensorrt"], 1, device_id, options)

    return open_it


def test_tensorrt_builds_strongly_typed_once_for_all_numbers_of_prompts(
    gpu, open_tiny, monkeypatch
):
    told = []
    open_tiny(told.append)
    assert gpu.flags == [1 << gpu.NetworkDefinitionCreationFlag.STRONGLY_TYPED]
    assert gpu.built == [{"txt_feats": ((1, 1, 2), (1, 2, 2), (1, 4, 2))}]
    assert told[0].state == "building engine"
    assert open_tiny().get_providers() == ["tensorrt"]
    assert len(gpu.built) == 1
    gpu.__version__ = "10.16.1"
    open_tiny()
    assert len(gpu.built) == 2
    monkeypatch.setattr(engines, "gpu_of", lambda *_: ("Fake Thor", "8.7"))
    open_tiny()
    assert len(gpu.built) == 3
    monkeypatch.setattr(tensorrt, "RECIPE", 0)
    open_tiny()
    assert len(gpu.built) == 4


def test_gpu_memory_is_freed_with_the_session(gpu, open_tiny):
    session = open_tiny()
    inputs = {"images": np.zeros((1, 3), np.float32), "txt_feats": np.zeros((1, 1, 2), np.float32)}
    for _ in range(3):
        bound = binding.bind(session, inputs, {"boxes": (1, 3)}, live=("images",))
        bound.run()
    gc.collect()
    assert len(gpu.cuda.memory) == 3
    del bound, session, inputs
    gc.collect()
    assert not gpu.cuda.memory
    assert gpu.cuda.calls.count("cudaHostRegister") == gpu.cuda.calls.count("cudaHostUnregister")


def test_more_prompts_than_the_engine_takes(gpu, open_tiny):
    inputs = {"images": np.zeros((1, 3), np.float32), "txt_feats": np.zeros((1, 5, 2), np.float32)}
    with pytest.raises(ValueError, match="search for fewer objects"):
        open_tiny().run(["boxes"], inputs)


def test_an_engine_that_does_not_load_is_kept(gpu, open_tiny):
    """The engine was either built now or found."""
    gpu.unreadable = 2
    for _ in range(2):
        with pytest.raises(ModelError, match=r"cannot load this engine: out of memory; .*remove"):
            open_tiny()
    open_tiny()
    assert len(gpu.built) == 1


def test_a_tensorrt_error_is_one_line_with_its_reason(gpu, open_tiny):
    gpu.refuses = True
    with pytest.raises(ModelError, match="cannot build an engine: no kernel for that"):
        open_tiny()
    gpu.faults = ["no importer registered\nfor op: Strange"]
    with pytest.raises(
        ModelError, match="cannot read the model: no importer registered for op"
    ) as error:
        open_tiny()
    assert "\n" not in str(error.value)


def test_a_missing_gpu_is_an_error_of_one_line(gpu, open_tiny):
    with pytest.raises(ModelError, match="device_id: 1, but there are 1 GPUs"):
        open_tiny(device_id=1)
    gpu.cuda.failing = {"cudaGetDeviceCount"}
    with pytest.raises(ModelError, match=r"no CUDA device: .*no CUDA-capable device"):
        open_tiny()
    assert not gpu.built


def test_memory_that_cannot_be_pinned_is_only_slower(gpu, open_tiny):
    gpu.cuda.failing = {"cudaHostRegister"}
    inputs = {"images": np.ones((1, 3), np.float32), "txt_feats": np.zeros((1, 1, 2), np.float32)}
    bound = binding.bind(open_tiny(), inputs, {"boxes": (1, 3)}, live=("images",))
    np.testing.assert_array_equal(bound.run()[0], [[1, 1, 1]])
    gpu.cuda.failing = {"cudaMemcpyAsync"}
    with pytest.raises(RuntimeError, match="cudaMemcpyAsync failed: no CUDA-capable device"):
        bound.run()


def test_packages_that_are_missing_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorrt", None)
    with pytest.raises(ModelError, match=r"pip install edge-vln\[tensorrt\]"):
        tensorrt.load()
    monkeypatch.setitem(sys.modules, "cuda.bindings", None)
    with pytest.raises(ModelError, match=r"cuda-bindings .*edge-vln\[tensorrt\]"):
        cuda.load()


def test_a_detector_sees_the_same_through_tensorrt(
    gpu,
    tiny,  # noqa: F811
    make_observation,
    caplog,
):
    seen = make_observation(rgb=np.full((48, 64, 3), 90, np.uint8))
    expected = tiny(prompts=("sofa", "chair")).detect(seen)
    gpu.context = OnnxContext
    with caplog.at_level(logging.INFO):
        detector = tiny(prompts=("bed",), providers=("tensorrt",), card={"precision": "fp32"})
    assert "building engine: tiny: 0 s" in caplog.text
    assert gpu.built == [{"txt_feats": ((1, 1, 512), (1, 16, 512), (1, 256, 512))}]
    assert len(detector.detect(seen)) == 0
    detector.set_prompts(["sofa", "chair"])
    found = detector.detect(seen)
    assert found.prompts == expected.prompts
    assert list(found.class_id) == list(expected.class_id)
    np.testing.assert_array_equal(found.score, expected.score)
    np.testing.assert_array_equal(found.xyxy_px, expected.xyxy_px)
    with pytest.raises(PromptError, match="at most 256"):
        detector.set_prompts(["chair"] * 257)
    assert detector.prompts == ("sofa", "chair")
    gpu.cuda.failing = {"cudaMalloc"}
    with pytest.raises(ModelError, match=r"^model tiny: it cannot be given the prompts: CUDA "):
        detector.set_prompts(["bed"])
    with pytest.raises(ModelError, match=r"^model tiny: it fails at its first image: CUDA "):
        tiny(providers=("tensorrt",), card={"precision": "fp32"})
    gpu.cuda.failing = set()
    assert detector.detect(seen).prompts == ("sofa", "chair")
    assert resources.cache_dir() / "engines" in {p.parent for p in engine_folders()}
    assert gpu.cuda.memory
    detector.close()
    gc.collect()
    assert not gpu.cuda.memory


@pytest.mark.parametrize("trusted", [False, True])
def test_no_engine_is_built_of_a_damaged_file(
    gpu,
    monkeypatch,
    tiny,  # noqa: F811
    trusted,
):
    """Otherwise it would be found under the sound file's hash after a repair."""
    if trusted:
        monkeypatch.setenv(TRUST_CACHE, "1")
    gpu.context = OnnxContext
    first = tiny(card={"precision": "fp32"})
    card, on_gpu = first.card, first.config.model_copy(update={"providers": ("tensorrt",)})
    settings = config.PerceptionConfig(detector=on_gpu)
    at = card.path.read_bytes().index(BOXES.tobytes()) + 1
    flip_a_byte(card.path, at)
    with pytest.raises(ModelError, match=r"tiny\.onnx: damaged or another model"):
        make_detector(settings, ("chair",))
    assert (gpu.built, engine_folders()) == ([], [])
    flip_a_byte(card.path, at)
    make_detector(settings, ("chair",)).close()
    assert len(gpu.built) == len(engine_folders()) == 1


def engine_folders():
    return [path.parent for path in resources.cache_dir().rglob("engine.json")]
