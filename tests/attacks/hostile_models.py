"""Detectors whose files look sound, and that give false results or never end."""

from __future__ import annotations

import hashlib

import yaml
from onnx_text import onnx_of

from edge.host import resources

_TEXT = """
g (float[1,3,64,64] images, float[1,n,512] txt_feats)
  => (float[1,a,4] boxes, float[1,a,n] scores) {
  light = ReduceMean<keepdims = 0> (images)
  zero = Constant<value = float {0.0}> ()
  nothing = Mul (light, zero)
  limit = Constant<value = float {%(over)s}> ()
  goes = Greater (light, limit)
  most = Constant<value = int64 {9223372036854775807}> ()
  spun = Loop (most, goes, nothing) <body = turn (int64 k, bool go, float x) => (bool on, float y) {
    on = Identity (go)
    y = Identity (x)
  }>
  box = Constant<value = float[1,2,4] {0.0, 0.0, 9.0, %(corner)s, 20.0, 20.0, 40.0, 40.0}> ()
  boxes = Add (box, spun)
  shape = Constant<value = int64[3] {1, 2, 512}> ()
  weights = ConstantOfShape<value = float[1] {0.0}> (shape)
  text = Transpose<perm = [0, 2, 1]> (txt_feats)
  flat = MatMul (weights, text)
  score = Constant<value = float {%(score)s}> ()
  scores = Add (flat, score)
}"""
_CARD = {
    "task": "detect", "family": "tiny", "license": "MIT", "sources": [], "precision": "fp32",
    "derived_from": None, "parity": None, "input": {"height": 64, "width": 64}, "text_dim": 512,
    "preprocess": {"color": "rgb", "scale": 1 / 255, "letterbox_pad": 114},
}  # fmt: skip
_SOUND = {"over": 9.0, "corner": 9.0, "score": 0.6}


def put_detector(name: str, **how: object) -> None:
    """Write a detector and its card to the folder of models.

    Args:
        name: of the card.
        how: `over`: it does not end for images with a mean (0 to 1) over this; `corner` and
            `score`: of its boxes.
    """
    content = onnx_of(_TEXT % {**_SOUND, **how})
    folder = resources.models_dir()
    folder.mkdir(parents=True, exist_ok=True)
    card = {**_CARD, "name": name, "file": f"{name}.onnx"}
    card["sha256"] = hashlib.sha256(content).hexdigest()
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(card))
    (folder / f"{name}.onnx").write_bytes(content)
