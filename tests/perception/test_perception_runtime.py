"""Choice of an execution provider, its options, and bound buffers.

No GPU is needed: onnxruntime runs here on the CPU. `DeviceBound` is run for real on onnxruntime's
own values with the device `cpu`; that CUDA's are used in the same way, and only then, is tested
with a session and a module that are fakes and named so. The real GPU: tests/integration/
test_gpu_runtime.py.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
import pytest
from onnx_text import onnx_of
from test_perception_cards import flip_a_byte

from edge.host import resources
from edge.perception.process.child import as_memory_error
from edge.perception.runtime import binding, cuda, engines
from edge.perception.runtime import sessions as runtime
from edge.perception.runtime.deadline import InferenceTimeout
from edge.perception.runtime.engines import EngineOptions
from edge.perception.runtime.health import is_out_of_memory
from edge.perception.runtime.model_file import ModelError, fresh_sha256
from edge.perception.runtime.sessions import ORT_TENSORRT, open_session, provider_options

ort = pytest.importorskip("onnxruntime")

SHAPES = {"txt_feats": ((1, 1, 512), (1, 16, 512), (1, 256, 512))}
CPU = "CPUExecutionProvider"


def engine(precision="fp32", **more):
    return EngineOptions("tiny", precision, SHAPES, **more)


def save_adder(folder, op="Add", opset=17, ir=8):
    """Save a model with `twice` = `fresh` + `fixed`, (1, 4)."""
    ends = "(float[1,4] fresh, float[1,4] fixed) => (float[1,4] twice)"
    text = f"g {ends} {{ twice = {op} (fresh, fixed) }}"
    made = onnx.load_from_string(onnx_of(text))
    made.ir_version, made.opset_import[0].version = ir, opset
    onnx.save(made, folder / "adds.onnx")
    return folder / "adds.onnx"


@pytest.fixture
def adds(tmp_path):
    """Return a session of `save_adder`'s model."""
    return open_session(save_adder(tmp_path), [CPU], threads=1)


@pytest.mark.parametrize(
    ("providers", "precision", "says"),
    [
        ((), "fp32", "providers: empty"),
        (("NoSuchProvider",), "fp32", r"'NoSuchProvider' is not available here .*CPUExecution"),
        (("tensorrt", CPU), "fp32", "'tensorrt' cannot be combined"),
        (("tensorrt",), "int8-cpu", "int8-trt"),
        ((ORT_TENSORRT, CPU), "int8-cpu", "int8-trt"),
    ],
)
def test_providers_that_cannot_be(tmp_path, providers, precision, says):
    with pytest.raises(ModelError, match=says) as error:
        open_session(tmp_path / "tiny.onnx", providers, 1, engine=engine(precision))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"not onnx", b"\x08\x07" * 50])
def test_an_invalid_model_file_is_an_error_of_one_line(tmp_path, content):
    (tmp_path / "tiny.onnx").write_bytes(content)
    with pytest.raises(ModelError, match="onnxruntime cannot load the model") as error:
        open_session(tmp_path / "tiny.onnx", [CPU], 1)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"op": "NoSuchOperator"}, "load the model: No Op registered for NoSuchOperator"),
        ({"ir": 99}, "load the model: Unsupported model IR version: 99"),
        ({"opset": 99}, r"load the model: ONNX Runtime only .*Opset 99"),
    ],
)
def test_an_unsupported_model_is_an_error_of_one_line(tmp_path, change, says):
    path = save_adder(tmp_path, **change)
    with pytest.raises(ModelError, match=says) as error:
        open_session(path, [CPU], 1)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400


def test_providers_without_options_get_none():
    assert provider_options(CPU, 1, engine(), Path("/e/key")) == {}
    assert provider_options("CUDAExecutionProvider", 1, engine(), Path("/e/key")) == {
        "device_id": "1"
    }


@pytest.mark.parametrize(
    ("precision", "fp16", "int8"),
    [("fp32", "False", "False"), ("fp16", "True", "False"), ("int8-trt", "True", "True")],
)
def test_options_of_onnxruntimes_tensorrt(precision, fp16, int8):
    told = provider_options(ORT_TENSORRT, 2, engine(precision, cache=Path("/e")), Path("/e/key"))
    assert told == {
        "device_id": "2", "trt_fp16_enable": fp16, "trt_int8_enable": int8,
        "trt_engine_cache_enable": "True", "trt_engine_cache_path": "/e/key",
        "trt_timing_cache_enable": "True", "trt_timing_cache_path": "/e",
        "trt_profile_min_shapes": "txt_feats:1x1x512",
        "trt_profile_opt_shapes": "txt_feats:1x16x512",
        "trt_profile_max_shapes": "txt_feats:1x256x512",
    }  # fmt: skip


def test_a_model_of_fixed_shapes_has_no_profile():
    told = provider_options(ORT_TENSORRT, 0, EngineOptions("tiny", "fp32"), Path("/e"))
    assert not [name for name in told if "profile" in name]


class FakeOrt:
    """Fake of the module onnxruntime: its TensorRT provider leaves a file for an engine."""

    __version__ = "1.30"

    def __init__(self):
        self.sessions = []

    def get_available_providers(self):
        return [ORT_TENSORRT, CPU]

    class SessionOptions:
        def add_session_config_entry(self, *_):
            pass

    def InferenceSession(self, path, options, providers, enable_fallback):
        told = dict(providers)[ORT_TENSORRT]
        folder = Path(told["trt_engine_cache_path"])
        self.sessions.append((folder, sorted(p.name for p in folder.iterdir())))
        (folder / "kernel_sm87.engine").write_bytes(b"engine")
        return SimpleNamespace(get_providers=lambda: [ORT_TENSORRT, CPU])


@pytest.fixture
def fake_ort(monkeypatch):
    """Install a fake onnxruntime on a machine that appears to have TensorRT and a GPU."""
    fake = FakeOrt()
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", fake)
    monkeypatch.setattr(runtime, "tensorrt_version", lambda key: "10.3.0")
    monkeypatch.setattr(engines, "gpu_of", lambda *_: ("Orin", "8.7"))
    return fake


def test_onnxruntimes_engine_is_built_once_and_then_loaded(fake_ort, tmp_path, monkeypatch):
    (tmp_path / "tiny.onnx").write_bytes(b"model")
    told = []
    options = engine("fp16", cache=tmp_path / "engines", progress=told.append)
    open_session(tmp_path / "tiny.onnx", [ORT_TENSORRT], 1, engine=options)
    (building, empty), (folder, kept) = fake_ort.sessions
    assert empty == []
    assert building != folder, "it gets its place only when it is whole"
    assert not building.exists()
    assert kept == ["engine.json", "kernel_sm87.engine"]
    assert [health.state for health in told] == ["building engine"]
    open_session(tmp_path / "tiny.onnx", [ORT_TENSORRT], 1, engine=options)
    assert fake_ort.sessions[2:] == [(folder, kept)]
    assert len(told) == 1
    orin_nx = lambda *_: ("Orin NX", "8.7")  # noqa: E731
    for module, name, other in ((engines, "gpu_of", orin_nx), (runtime, "RECIPE", 0)):
        monkeypatch.setattr(module, name, other)
        open_session(tmp_path / "tiny.onnx", [ORT_TENSORRT], 1, engine=options)
    assert len(told) == 3


def test_a_damaged_model_gets_no_engine(fake_ort, tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    path, options = tmp_path / "tiny.onnx", engine("fp16", cache=tmp_path / "engines")
    path.write_bytes(b"model")
    fresh_sha256(path)
    flip_a_byte(path)
    with pytest.raises(ModelError, match=r"tiny\.onnx: damaged or another model: .*again$"):
        open_session(path, [ORT_TENSORRT], 1, engine=options)
    assert not fake_ort.sessions
    assert not list((tmp_path / "engines").rglob("*.engine"))


@pytest.mark.parametrize("providers", [(ORT_TENSORRT,), ("tensorrt",)])
def test_missing_tensorrt_is_an_error_of_one_line(tmp_path, monkeypatch, providers):
    (tmp_path / "tiny.onnx").write_bytes(b"model")
    monkeypatch.setattr(ort, "get_available_providers", lambda: [ORT_TENSORRT, CPU])
    monkeypatch.setitem(__import__("sys").modules, "tensorrt", None)
    monkeypatch.setattr(runtime.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(runtime.ctypes, "CDLL", lambda name: (_ for _ in ()).throw(OSError(name)))
    with pytest.raises(ModelError, match=r"TensorRT.*(not found|not installed)") as error:
        open_session(tmp_path / "tiny.onnx", providers, 1, engine=engine(cache=tmp_path))
    assert "\n" not in str(error.value)


def test_a_missing_driver_or_gpu_is_an_error(monkeypatch):
    monkeypatch.setattr(cuda.ctypes, "CDLL", lambda name: (_ for _ in ()).throw(OSError(name)))
    with pytest.raises(ModelError, match="no CUDA driver"):
        cuda.gpu_of(0)
    broken = SimpleNamespace(cuInit=lambda flags: 100)
    monkeypatch.setattr(cuda.ctypes, "CDLL", lambda name: broken)
    with pytest.raises(ModelError, match=r"^perception\.detector\.device_id: no GPU 3"):
        cuda.gpu_of(3)


@pytest.mark.parametrize("section", ["perception.segmenter", "tasks.ground", "perception.choice"])
def test_messages_name_the_section_of_the_model(tmp_path, monkeypatch, section):
    options = replace(engine(), section=section, cache=tmp_path)
    (tmp_path / "tiny.onnx").write_bytes(b"model")
    for providers in (["tensorrt"], ["NoSuchProvider"], []):
        with pytest.raises(ModelError, match=f"^{section}.providers: "):
            runtime.open_onnxruntime_session(tmp_path / "tiny.onnx", providers, 1, 0, options)
    monkeypatch.setattr(ort, "get_available_providers", lambda: [ORT_TENSORRT, CPU])
    monkeypatch.setattr(runtime, "tensorrt_version", lambda key: "10.3.0")
    driver = SimpleNamespace(cuInit=lambda flags: 100)
    monkeypatch.setattr(cuda.ctypes, "CDLL", lambda name: driver)
    with pytest.raises(ModelError, match=f"^{section}.device_id: no GPU 0"):
        open_session(tmp_path / "tiny.onnx", [ORT_TENSORRT], 1, engine=options)
    monkeypatch.setattr(engines, "gpu_of", lambda *_: ("Orin", "8.7"))
    options = replace(options, cache=tmp_path / "tiny.onnx")  # a file, not a folder
    with pytest.raises(ModelError, match="make it writable, or set EDGE_CACHE_DIR"):
        open_session(tmp_path / "tiny.onnx", [ORT_TENSORRT], 1, engine=options)


def test_a_gpu_is_asked_for_its_name_and_capability(monkeypatch):
    def name(buffer, size, device):
        buffer.value = b"Orin"[: size - 1]

    def attribute(value, which, device):
        value._obj.value = {75: 8, 76: 7}[which]

    driver = SimpleNamespace(
        cuInit=lambda flags: 0, cuDeviceGet=lambda device, index: 0,
        cuDeviceGetName=name, cuDeviceGetAttribute=attribute,
    )  # fmt: skip
    monkeypatch.setattr(cuda.ctypes, "CDLL", lambda name: driver)
    assert cuda.gpu_of(0) == ("Orin", "8.7")


def feeds():
    return {
        "fresh": np.array([[1, 2, 3, 4]], np.float32),
        "fixed": np.array([[10, 20, 30, 40]], np.float32),
    }


def make_host(session, arrays, outputs):
    return binding.bind(session, arrays, outputs, live=("fresh",))


def make_device(session, arrays, outputs):
    return binding.DeviceBound(session, arrays, outputs, ("fresh",), "cpu", 0)


@pytest.mark.parametrize("make", [make_host, make_device])
def test_live_inputs_are_read_before_every_run(adds, make):
    arrays = feeds()
    bound = make(adds, arrays, {"twice": (1, 4)})
    np.testing.assert_array_equal(bound.run()[0], [[11, 22, 33, 44]])
    arrays["fresh"][:] = -1
    np.testing.assert_array_equal(bound.run()[0], [[9, 19, 29, 39]])


def test_on_the_cpu_nothing_is_copied_or_allocated(adds):
    arrays = feeds()
    bound = make_host(adds, arrays, {"twice": (1, 4)})
    first = bound.run()[0]
    arrays["fixed"][:] = 0  # read in place, too
    assert bound.run()[0] is first
    np.testing.assert_array_equal(first, arrays["fresh"])


class FakeValue:
    """Fake of onnxruntime.OrtValue on a device: a copy that counts its transfers."""

    def __init__(self, array, device, index):
        self.array, self.where, self.uploads = array.copy(), (device, index), 1

    ortvalue_from_numpy = staticmethod(lambda a, device, index: FakeValue(a, device, index))

    @staticmethod
    def ortvalue_from_shape_and_type(shape, dtype, device, index):
        return FakeValue(np.zeros(shape, dtype), device, index)

    def update_inplace(self, array):
        self.uploads += 1
        self.array[:] = array

    def numpy(self):
        return self.array.copy()


class FakeCudaSession:
    """Fake of a session on CUDA that adds its two inputs."""

    def __init__(self, provider="CUDAExecutionProvider"):
        self.provider, self.bound = provider, {}

    def get_providers(self):
        return [self.provider, CPU]

    def get_provider_options(self):
        return {self.provider: {"device_id": "1"}, CPU: {}}

    def io_binding(self):
        keep = self.bound.__setitem__
        nothing = lambda: None  # noqa: E731
        return SimpleNamespace(
            bind_ortvalue_input=keep,
            bind_ortvalue_output=keep,
            synchronize_inputs=nothing,
            synchronize_outputs=nothing,
        )

    def run_with_iobinding(self, bound):
        self.bound["twice"].array[:] = self.bound["fresh"].array + self.bound["fixed"].array


@pytest.mark.parametrize("provider", ["CUDAExecutionProvider", ORT_TENSORRT])
def test_only_live_inputs_are_uploaded_to_cuda_again(monkeypatch, provider):
    monkeypatch.setattr(ort, "OrtValue", FakeValue)
    session, arrays = FakeCudaSession(provider), feeds()
    bound = binding.bind(session, arrays, {"twice": (1, 4)}, live=("fresh",))
    for _ in range(3):
        arrays["fresh"] += 1
        np.testing.assert_array_equal(bound.run()[0], arrays["fresh"] + arrays["fixed"])
    assert {value.where for value in session.bound.values()} == {("cuda", 1)}
    assert session.bound["fixed"].uploads == 1
    assert session.bound["fresh"].uploads == 4


@pytest.mark.parametrize("package", ["edge", "exporters"])
def test_a_model_that_ran_leaves_nothing_in_the_home_folder(package, tmp_path):
    model = resources.data_dir("models") / "mini-house-256x320-int8-cpu.onnx"
    code = (
        f"import {package}, onnxruntime\n"
        f"onnxruntime.InferenceSession({str(model)!r}, providers=['CPUExecutionProvider'])"
    )
    # Nothing else of the environment: variables of a CI keep onnxruntime quiet, too.
    environ = {"HOME": str(tmp_path), "PATH": os.environ["PATH"]}
    subprocess.run([sys.executable, "-c", code], env=environ, check=True)
    assert [str(path) for path in tmp_path.rglob("*")] == []


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (MemoryError(), True),
        (RuntimeError("Failed to allocate memory for requested buffer of size 9"), True),
        (RuntimeError("CUDA could not allocate memory"), True),
        (RuntimeError("std::bad_alloc"), True),
        (RuntimeError("bad allocation"), True),
        (RuntimeError("CUDA failure 2: out of memory"), True),
        (RuntimeError("the memory of the model"), False),
    ],
)
def test_a_lack_of_memory_is_known_by_its_message(error, expected):
    assert is_out_of_memory(error) == expected
    assert isinstance(as_memory_error(error), MemoryError) == expected
    with pytest.raises(ModelError) as raised, InferenceTimeout("tiny").within(9.0):
        raise error
    assert ("out of memory (" in str(raised.value)) == expected
