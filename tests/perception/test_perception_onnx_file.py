"""Checks of a model's file before onnxruntime loads it."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx_bytes import (
    DETECTOR,
    FLOAT,
    INT64,
    detector,
    field,
    graph,
    interface,
    model,
    node,
    tensor,
)

from edge.perception.runtime import card_types
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.onnx_file import (
    NotOnnxError,
    OnnxFile,
    Value,
    check_file,
    check_interface,
    parse_onnx,
    read_onnx,
)

SHARED = {
    "name": "tiny", "family": "f", "file": "tiny.onnx", "sha256": None, "sources": (),
    "license": "MIT", "precision": "fp32", "derived_from": None, "parity": None,
}  # fmt: skip
INPUT = {"height": 64, "width": 64}
CARD = card_types.DetectCard(
    **SHARED, task="detect", input=INPUT, text_dim=512,
    preprocess={"color": "rgb", "scale": 1.0, "letterbox_pad": 0},
)  # fmt: skip
TEXT = card_types.TextCard(**SHARED, task="text", dim=8, tokenizer={"kind": "attributes"})
IMAGE = card_types.ImageCard(
    **SHARED, task="image", input=INPUT, dim=8,
    preprocess={"color": "rgb", "scale": 1.0, "mean": [0, 0, 0], "std": [1, 1, 1]},
)  # fmt: skip


@pytest.fixture
def check(tmp_path):
    def run(content, card=CARD):
        path = tmp_path / "tiny.onnx"
        path.write_bytes(content)
        check_file(path, card)

    return run


def test_an_empty_file(check):
    with pytest.raises(ModelError, match=r"tiny\.onnx: not an ONNX model: it is empty"):
        check(b"")


def test_a_sound_model(check):
    check(detector())
    found = parse_onnx(detector())
    assert (found.ir, found.opset, found.unknown_domains, found.external) == (9, 19, [], [])
    assert found.inputs == [
        Value("images", FLOAT, (1, 3, 64, 64)), Value("txt_feats", FLOAT, (1, None, 512)),
    ]  # fmt: skip


def branch(inside):
    """Return an If node with the graph as its branch."""
    return node("If", attribute=field(1, "then_branch") + field(6, inside))


OUTSIDE = tensor("w", "../../etc/passwd")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"not onnx", "not an ONNX model"),
        (b"\x80" * 30, "not an ONNX model: ends within a number"),
        (field(1, 9), "there is no graph"),
        (field(7, graph()), "the header is not that of ONNX"),
        (detector()[:-1], "not an ONNX model"),
        (detector(ir=11), "ONNX IR version 11, at most 10"),
        (detector(opset=21), "ONNX opset 21, must be 1 to 20"),
        (detector(opset=0), "ONNX opset 0, must be"),
        (
            detector([node("Gelu", "my.lab")]),
            "operators of the domain 'my.lab', which onnxruntime lacks",
        ),
        (
            detector([branch(graph(nodes=(node("X", "deep.lab"),)))]),
            "operators of the domain 'deep.lab'",
        ),
        (detector(tensors=[OUTSIDE]), "'../../etc/passwd', outside its folder"),
        (detector(tensors=[tensor("w", "/etc/passwd")]), "'/etc/passwd', outside its folder"),
        (detector(tensors=[tensor("w", "C:\\..\\x")]), "outside its folder"),
        (detector(tensors=[tensor("w", "weights.bin")]), "'weights.bin', that no hash covers"),
        (detector(tensors=[field(14, 1)]), "'', that no hash covers"),
        (detector([branch(graph(tensors=(OUTSIDE,)))]), "outside its folder"),
        (detector([node("Constant", attribute=field(5, OUTSIDE))]), "outside its folder"),
        (detector(more=field(20, field(1, graph(tensors=(OUTSIDE,))))), "outside its folder"),
        (detector(more=field(7, graph(tensors=(OUTSIDE,)))), "the header is not that of ONNX"),
    ],
)
def test_a_file_unfit_for_a_session_is_refused(check, content, message):
    with pytest.raises(ModelError) as error:
        check(content)
    assert message in str(error.value)
    assert "tiny.onnx: " in str(error.value)
    assert "\n" not in str(error.value)


def test_functions_of_the_model_count_as_known_operators(check):
    function = field(1, "F") + field(10, "my.lab") + field(7, node("Identity"))
    check(detector([node("F", "my.lab")], more=field(25, function)))


def test_deep_nesting_is_refused(check):
    inside = graph()
    for _ in range(60):
        inside = graph(nodes=(branch(inside),))
    with pytest.raises(ModelError, match="nested more than"):
        check(model(inside))


@pytest.mark.parametrize(
    ("limit", "content"),
    [("FIELDS", field(1, 9) * 1001), ("PARTS", field(7, field(1, b"") * 1000))],
)
def test_a_file_with_too_many_parts_is_refused(monkeypatch, limit, content):
    monkeypatch.setattr(f"edge.perception.runtime.onnx_file.MAX_{limit}", 1000)
    with pytest.raises(NotOnnxError, match=f"more than 1000 {limit.lower()}"):
        parse_onnx(content)


IN, OUT = DETECTOR["inputs"], DETECTOR["outputs"]


@pytest.mark.parametrize(
    ("card", "inputs", "outputs", "fits"),
    [
        (CARD, IN, OUT, True),
        (CARD, {}, {}, False),
        (CARD, {**IN, "images": (FLOAT, (1, 3, 32, 64))}, OUT, False),
        (CARD, {**IN, "images": (FLOAT, ("n", 3, 64, 64))}, OUT, False),
        (CARD, {**IN, "images": (FLOAT, None)}, OUT, False),
        (CARD, {**IN, "images": (2, (1, 3, 64, 64))}, OUT, False),
        (CARD, {**IN, "txt_feats": (FLOAT, (1, 80, 512))}, OUT, False),
        (CARD, {**IN, "more": (FLOAT, (1,))}, OUT, False),
        (CARD, IN, {"scores": OUT["scores"], "boxes": OUT["boxes"]}, False),
        (CARD, IN, {**OUT, "boxes": (FLOAT, (1, 3, 6))}, False),
        (CARD, IN, {**OUT, "boxes": (10, (1, 3, 4))}, False),
        (CARD, IN, {**OUT, "boxes": (FLOAT, None)}, True),
        (TEXT, {"tokens": (INT64, ("n", 77))}, {"embeddings": (FLOAT, ("n", 8))}, True),
        (TEXT, {"tokens": (INT64, ("n", "t"))}, {"embeddings": (FLOAT, ("n", 8))}, True),
        (TEXT, {"tokens": (INT64, (1, 77))}, {"embeddings": (FLOAT, (1, 8))}, False),
        (TEXT, {"tokens": (FLOAT, ("n", 77))}, {"embeddings": (FLOAT, ("n", 8))}, False),
        (TEXT, {"tokens": (INT64, ("n", 77))}, {"embeddings": (FLOAT, ("n", 9))}, False),
        (IMAGE, {"pixels": (FLOAT, (1, 3, 64, 64))}, {"embeddings": (FLOAT, (1, 8))}, True),
        (IMAGE, {"pixels": (FLOAT, (1, 3, 64, 64))}, {"embeddings": (FLOAT, (8,))}, False),
    ],
)
def test_inputs_and_outputs_by_task(tmp_path, card, inputs, outputs, fits):
    found = parse_onnx(model(graph(interface(inputs=inputs, outputs=outputs))))
    if fits:
        check_interface(tmp_path, found, card)
    else:
        with pytest.raises(ModelError, match=r"inputs \(.*must have inputs .*: export the model"):
            check_interface(tmp_path, found, card)


SOUND = detector(
    [node("Conv"), branch(graph(nodes=(node("Relu"),)))], [tensor("w", raw=bytes(range(200)))]
)


@given(st.data())
def test_damage_is_reported_or_harmless(data):
    cut = data.draw(st.integers(0, len(SOUND)))
    damaged = bytearray(SOUND[:cut])
    for _ in range(data.draw(st.integers(0, 5)) if damaged else 0):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    with contextlib.suppress(NotOnnxError):
        assert isinstance(parse_onnx(bytes(damaged)), OnnxFile)


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(content):
    with contextlib.suppress(NotOnnxError):
        parse_onnx(content)


def test_the_reader_agrees_with_onnx(tmp_path):
    onnx = pytest.importorskip("onnx")
    parsed = onnx.ModelProto.FromString(SOUND)
    assert parsed.ir_version == 9
    assert parsed.graph.node[1].attribute[0].g.node[0].op_type == "Relu"
    assert parsed.graph.input[1].type.tensor_type.shape.dim[1].dim_param == "n"
    made = onnx.helper.make_model(parsed.graph, ir_version=8)
    made.opset_import[0].version = 17
    path = tmp_path / "m.onnx"
    path.write_bytes(made.SerializeToString())
    found = read_onnx(path)
    assert (found.ir, found.opset) == (8, 17)
    assert found.inputs == parse_onnx(SOUND).inputs
