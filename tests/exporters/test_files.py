"""Digests, atomic writes, image folders, vocabularies, ONNX versions: errors of users."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("onnx", reason="onnx is not installed (extra `export`)")

import onnx

from edge.host import resources
from edge.perception.runtime.letterbox import letterboxed
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.onnx_file import MAX_IR, MAX_OPSET
from exporters.__main__ import load_card
from exporters.files import ExportError, check_sha256, sha256_of
from exporters.images import CENTRED, list_images, load_input, load_text_embeddings
from exporters.onnx_format import check_format

pytestmark = pytest.mark.export


def test_check_sha256(tmp_path: Path):
    file = tmp_path / "weights.pt"
    file.write_bytes(b"")
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    assert sha256_of(file) == empty
    check_sha256(file, empty)
    with pytest.raises(ExportError, match=r"weights\.pt: SHA-256 is e3b0c44298fc…, expected 0000"):
        check_sha256(file, "0" * 64)
    with pytest.raises(ExportError, match="cannot be read"):
        sha256_of(tmp_path / "missing.pt")


@pytest.mark.parametrize(
    ("size_hw", "rows", "columns"),
    [((64, 96), slice(0, 64), slice(0, 96)), ((50, 200), slice(20, 44), slice(0, 96))],
)
def test_letterbox_centres_on_grey(size_hw, rows, columns):
    out = letterboxed(np.full((*size_hw, 3), 255, np.uint8), (64, 96), *CENTRED)[0]
    inside = np.zeros((64, 96), bool)
    inside[rows, columns] = True
    assert (out[inside] == 255).all()
    assert (out[~inside] == 114).all()


def test_letterbox_in_the_corner():
    out, _ = letterboxed(np.full((50, 200, 3), 255, np.uint8), (64, 96), 128, "corner")
    assert (out[:24] == 255).all()
    assert (out[24:] == 128).all()


def test_load_input_is_rgb_in_0_to_1(tmp_path: Path):
    path = tmp_path / "blue.png"
    cv2.imwrite(str(path), np.full((32, 32, 3), (255, 0, 0), np.uint8))
    image = load_input(path, (32, 32))
    assert image.shape == (1, 3, 32, 32)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image[0, :, 0, 0], [0, 0, 1])
    with pytest.raises(ExportError, match="no images"):
        list_images(tmp_path / "none")
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(ExportError, match=r"text\.png: not a readable image"):
        load_input(tmp_path / "text.png", (32, 32))


def test_load_text_embeddings(tmp_path: Path):
    path = tmp_path / "words.npz"
    np.savez(path, names=["chair", "unicorn"], emb=np.full((2, 512), 2, np.float16))
    text = load_text_embeddings(path)
    assert text.names == ("chair",)
    np.testing.assert_allclose(np.linalg.norm(text.emb, axis=1), 1, rtol=1e-6)
    path.write_bytes(b"chair")
    with pytest.raises(ExportError, match=r"words\.npz: not a vocabulary"):
        load_text_embeddings(path)
    np.savez(path, names=["unicorn"], emb=np.ones((1, 512)))
    with pytest.raises(ExportError, match="has none of the usual targets"):
        load_text_embeddings(path)


def tiny_model(path: Path, ir: int, opset: int) -> Path:
    value = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [1])
    result = onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [1])
    node = onnx.helper.make_node("Identity", ["x"], ["y"])
    graph = onnx.helper.make_graph([node], "tiny", [value], [result])
    opsets = [onnx.helper.make_opsetid("", opset)]
    onnx.save(onnx.helper.make_model(graph, ir_version=ir, opset_imports=opsets), path)
    return path


def test_check_format(tmp_path: Path):
    check_format(tiny_model(tmp_path / "good.onnx", MAX_IR, MAX_OPSET))
    with pytest.raises(ExportError, match=r"new\.onnx: ONNX IR version 11, at most 10"):
        check_format(tiny_model(tmp_path / "new.onnx", MAX_IR + 1, MAX_OPSET))
    with pytest.raises(ExportError, match="opset 21, must be 1 to 20"):
        check_format(tiny_model(tmp_path / "new.onnx", MAX_IR, MAX_OPSET + 1))


def test_load_card_lists_the_choices(tmp_path: Path):
    (tmp_path / "small.yaml").write_text("name: small\n")
    with pytest.raises(ExportError, match=r"no model card 'large' \(choices: small\)"):
        load_card("large", tmp_path)
    with pytest.raises(ModelError, match=r"small\.yaml: task: missing"):
        load_card("small", tmp_path)


def test_load_card_names_the_command_of_our_own_family():
    with pytest.raises(ExportError, match=r"`python -m exporters\.training\.mini --out RUN`"):
        load_card("mini-house-text", resources.data_dir("models"))
