"""Models on a real CUDA GPU, where there is one with the packages; skips with the reason else.

    pip install edge-vln[gpu,tensorrt] && pytest tests/integration/test_gpu_runtime.py -m ''

The network is made here, of convolutions with a text input like a detector's, so that no weights
are needed; int8 and the real weights are `edge bench --models`'s part.
"""

from __future__ import annotations

import numpy as np
import pytest

from edge.perception.runtime import binding
from edge.perception.runtime.cuda import gpu_of
from edge.perception.runtime.engines import EngineOptions
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.sessions import ORT_TENSORRT, TENSORRT, open_session

ort = pytest.importorskip("onnxruntime")
onnx = pytest.importorskip("onnx")

pytestmark = pytest.mark.slow

CUDA = "CUDAExecutionProvider"
HW, CHANNELS, CELLS = (64, 80), 16, 32 * 40


@pytest.fixture(scope="module")
def gpu():
    """Skips without a driver and a GPU."""
    try:
        return gpu_of(0)
    except ModelError as error:
        pytest.skip(f"no GPU: {error}")


def needs(provider):
    if provider == TENSORRT:
        pytest.importorskip("tensorrt", reason="TensorRT's Python package is not installed")
        pytest.importorskip("cuda.bindings.runtime", reason="cuda-bindings is not installed")
    elif provider not in ort.get_available_providers():
        pytest.skip(f"this onnxruntime has no {provider}")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """make(half): `scores` (1, cells, n) = sigmoid(conv(images) · txt_feats), as float32 or 16."""
    from onnx import TensorProto, helper, numpy_helper

    random = np.random.default_rng(0)

    def make(half):
        inner = TensorProto.FLOAT16 if half else TensorProto.FLOAT
        weight = random.normal(0, 0.2, (CHANNELS, 3, 3, 3))
        nodes = [
            helper.make_node("Cast", ["images"], ["x"], to=inner),
            helper.make_node("Cast", ["txt_feats"], ["t"], to=inner),
            helper.make_node("Conv", ["x", "w"], ["c"], strides=[2, 2], pads=[1, 1, 1, 1]),
            helper.make_node("Reshape", ["c", "flat"], ["f"]),
            helper.make_node("Transpose", ["f"], ["ft"], perm=[0, 2, 1]),
            helper.make_node("Transpose", ["t"], ["tt"], perm=[0, 2, 1]),
            helper.make_node("MatMul", ["ft", "tt"], ["m"]),
            helper.make_node("Sigmoid", ["m"], ["s"]),
            helper.make_node("Cast", ["s"], ["scores"], to=TensorProto.FLOAT),
        ]
        value = helper.make_tensor_value_info
        graph = helper.make_graph(
            nodes,
            "text",
            [
                value("images", TensorProto.FLOAT, [1, 3, *HW]),
                value("txt_feats", TensorProto.FLOAT, [1, "n", CHANNELS]),
            ],
            [value("scores", TensorProto.FLOAT, [1, CELLS, "n"])],
            [
                numpy_helper.from_array(weight.astype(np.float16 if half else np.float32), "w"),
                numpy_helper.from_array(np.array([1, CHANNELS, CELLS]), "flat"),
            ],
        )
        opset = [helper.make_opsetid("", 17)]
        path = tmp_path_factory.mktemp("gpu") / f"text{16 if half else 32}.onnx"
        onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), path)
        return path

    return make


def feed(n):
    random = np.random.default_rng(n)
    return {
        "images": random.random((1, 3, *HW), np.float32),
        "txt_feats": random.normal(0, 0.3, (1, n, CHANNELS)).astype(np.float32),
    }


def options(cache, half, told):
    shapes = {"txt_feats": tuple((1, n, CHANNELS) for n in (1, 16, 64))}
    return EngineOptions("text", "fp16" if half else "fp32", shapes, cache, told.append)


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("provider", [CUDA, ORT_TENSORRT, TENSORRT])
def test_gpu_scores_agree_with_the_cpu(gpu, model, tmp_path, provider, half):
    needs(provider)
    path, told = model(half), []
    cpu = open_session(path, ["CPUExecutionProvider"], 2)
    session = open_session(path, [provider], 2, 0, options(tmp_path, half, told))
    for n in (1, 3, 40):
        inputs = feed(n)
        bound = binding.bind(session, inputs, {"scores": (1, CELLS, n)}, live=("images",))
        for _ in range(2):
            inputs["images"][:] = np.random.default_rng(n).random((1, 3, *HW), np.float32)
            expected = cpu.run(["scores"], inputs)[0]
            np.testing.assert_allclose(bound.run()[0], expected, atol=5e-3)


@pytest.mark.parametrize("provider", [ORT_TENSORRT, TENSORRT])
def test_the_second_start_takes_the_engine_from_the_cache(gpu, model, tmp_path, provider):
    needs(provider)
    path, told = model(False), []
    open_session(path, [provider], 2, 0, options(tmp_path, False, told))
    assert told, "it says that it builds"
    assert all(health.state == "building engine" for health in told)
    folders = {entry for entry in tmp_path.iterdir() if entry.is_dir()}
    engines = {p: p.stat().st_mtime_ns for entry in folders for p in entry.glob("*.engine")}
    assert engines
    told.clear()
    open_session(path, [provider], 2, 0, options(tmp_path, False, told))
    assert not told
    assert engines == {path: path.stat().st_mtime_ns for path in engines}


def test_a_damaged_engine_is_built_again(gpu, model, tmp_path):
    needs(TENSORRT)
    path, told = model(False), []
    open_session(path, [TENSORRT], 2, 0, options(tmp_path, False, told))
    (engine,) = tmp_path.glob("*/model.engine")
    engine.write_bytes(engine.read_bytes()[:-100])
    told.clear()
    session = open_session(path, [TENSORRT], 2, 0, options(tmp_path, False, told))
    assert told
    assert session.run(["scores"], feed(2))[0].shape == (1, CELLS, 2)
