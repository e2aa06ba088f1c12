"""`edge models list --check` on small models written as ONNX's text, sound and unsound."""

from __future__ import annotations

import hashlib
import json
import os

import pytest
from onnx_text import onnx_of

from edge.cli.main import main
from edge.host import resources
from edge.models.check import check_model
from edge.models.make import load_single_file_card
from edge.perception.runtime.model_file import ModelError

pytest.importorskip("onnxruntime")

DETECTOR = """
g (float[1,3,64,64] images, float[1,n,8] txt_feats) => (float[1,a,4] boxes, float[1,a,n] scores) {
  boxes = Constant<value = float[1,2,4] {0.0, 0.0, 9.0, 9.0, 1.0, 1.0, 8.0, 8.0}> ()
  shape = Constant<value = int64[3] {1, 2, 8}> ()
  weights = ConstantOfShape<value = float[1] {0.5}> (shape)
  text = Transpose<perm = [0, 2, 1]> (txt_feats)
  raw = MatMul (weights, text)
  scores = Sigmoid (raw)
}"""
TEXT = """
g (int64[n,3] tokens) => (float[n,8] embeddings) {
  shape = Constant<value = int64[2] {5, 8}> ()
  table = ConstantOfShape<value = float[1] {0.5}> (shape)
  rows = Gather (table, tokens)
  embeddings = ReduceMean<axes = [1], keepdims = 0> (rows)
}"""
IMAGE = """
g (float[1,3,64,64] pixels) => (float[1,d] embeddings) {
  mean = ReduceMean<axes = [1, 2, 3], keepdims = 0> (pixels)
  shape = Constant<value = int64[2] {1, 8}> ()
  embeddings = Expand (mean, shape)
}"""
GROUND = """
g (float[1,3,64,64] x) => (float[1,k,r,c] y) {
  shape = Constant<value = int64[4] {19, 3, 1, 1}> ()
  weights = ConstantOfShape<value = float[1] {0.5}> (shape)
  y = Conv (x, weights)
}"""
SHARED = {
    "family": "f", "sha256": None, "sources": [], "license": "MIT", "precision": "fp32",
    "derived_from": None, "parity": None,
}  # fmt: skip
SIZE = {"height": 64, "width": 64}
PIXELS = {"color": "rgb", "scale": 1.0}
CARDS = {
    "detect": {
        "input": SIZE, "text_dim": 8, "preprocess": {**PIXELS, "letterbox_pad": 0},
    },
    "text": {"dim": 8, "tokenizer": {"kind": "attributes"}},
    "image": {"input": SIZE, "dim": 8, "preprocess": {**PIXELS, "mean": [0] * 3, "std": [1] * 3}},
    "ground": {"input": SIZE, "preprocess": {**PIXELS, "mean": [0] * 3, "std": [1] * 3}},
}  # fmt: skip
MODELS = {"detect": DETECTOR, "text": TEXT, "image": IMAGE, "ground": GROUND}


@pytest.fixture
def put(put_card):
    """put(task, change=(old, new)): a card named as its task, and the model it is of."""

    def write(task, change=("", ""), digest=None):
        put_card({"name": task, "file": f"{task}.onnx", "task": task, **SHARED, **CARDS[task]})
        content = onnx_of(MODELS[task].replace(*change))
        path = resources.models_dir() / f"{task}.onnx"
        path.write_bytes(content)
        made = {"sha256": digest or hashlib.sha256(content).hexdigest()}
        path.with_name(path.name + ".json").write_text(json.dumps(made))
        return path

    return write


def check(capsys, *words):
    """(exit code, lines of stdout, lines of stderr)."""
    code = main(["models", "list", "--check", *map(str, words)])
    out, err = capsys.readouterr()
    return code, out.splitlines(), err.splitlines()


def test_nothing_to_check(put_card, capsys):
    code, out, (error,) = check(capsys)
    assert (code, out) == (1, [])
    assert "edge models list" in error


@pytest.mark.parametrize(
    ("task", "change", "message"),
    [
        ("detect", ("Sigmoid (raw)", "Log (raw)"), "returns scores that are not finite"),
        ("detect", ("9.0, 9.0", "9.0, 1e9"), "far outside the image"),
        ("detect", ("{1, 2, 8}", "{1, 3, 8}"), "scores of shape (1, 3, 2), must be (1, 2, 2)"),
        ("text", ("{5, 8}", "{0, 8}"), "does not run"),
        ("text", ("{0.5}", "{0.0}"), "an embedding is all zeros"),
        ("image", ("{1, 8}", "{1, 9}"), "embeddings of shape (1, 9), must be (1, 8)"),
        ("ground", ("{19, 3", "{18, 3"), "output (1, 18, 64, 64) of float32; must be finite"),
        ("ground", ("[1,3,64,64] x", "[1,3,64,32] x"), "must have one input"),
    ],
)
def test_an_unsound_model_is_an_error_of_one_line(put, task, change, message):
    path = put(task, change)
    with pytest.raises(ModelError) as raised:
        check_model(load_single_file_card(task))
    assert message in str(raised.value)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_undecodable_text_of_onnxruntime_becomes_one_line(put, capfd):
    path = put("detect")
    path.write_bytes(path.read_bytes().replace(b"Sigmoid", b"Sig\xd3oid"))
    assert (
        main(["models", "list", "--check", "detect", "--file", str(path.rename(f"{path}.bad"))])
        == 1
    )
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "onnxruntime cannot load the model" in err


def test_a_bad_model_does_not_stop_other_checks(put, capsys):
    put("detect", digest="0" * 64)
    put("text")
    code, out, (error,) = check(capsys)
    assert (code, len(out)) == (1, 1)
    assert "damaged or another model" in error


def test_a_file_held_against_a_card(put, tmp_path, capsys):
    path = put("text")
    other = tmp_path / "other.onnx"
    other.write_bytes(path.read_bytes())
    assert check(capsys, "text", "--file", other)[1] == [
        "text: ok (hash not known, interface, embeddings of 8, finite)"
    ]
    assert "must have inputs" in check(capsys, "text", "--file", put("image"))[2][0]
    assert "no such file" in check(capsys, "text", "--file", tmp_path / "none.onnx")[2][0]
    code, _, (error,) = check(capsys, "--file", other)
    assert (code, "--file needs the NAME" in error) == (os.EX_UNAVAILABLE, True)
