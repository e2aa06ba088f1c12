"""A network that names the class of each pixel, with known weights, and its card.

It classifies by colour: green is terrain, blue is sky, dark is a car, all else is road.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import yaml
from onnx_text import onnx_of

from edge import config
from edge.host import resources
from edge.perception.runtime.card_types import CITYSCAPES

ROWS = {"road": (0, 0, 0, 0.4), "terrain": (-1, 2, -1, 0), "sky": (-2, 0, 2, 0.3),
        "car": (-9, -9, -9, 2)}  # fmt: skip
"""Class → its score's factors of red, green and blue, and its bias."""
HW = 64, 96
OUTPUTS = {
    "scores": ("float[1,19,r,c] y", "y = Conv (x, w, b)"),
    "best class": ("int64[1,r,c] y", "s = Conv (x, w, b) y = ArgMax<axis = 1, keepdims = 0> (s)"),
}


def _network(declared: str, made: str) -> bytes:
    rows = np.array([ROWS.get(name, (0, 0, 0, -99)) for name in CITYSCAPES], np.float32)
    text = f"g (float[1,3,{HW[0]},{HW[1]}] x) => ({declared}) {{ {made} }}"
    return onnx_of(text, w=rows[:, :3, None, None], b=rows[:, 3])


def put_network(output: str = "scores", name: str = "tiny-ground", **changes: Any):
    """Write the network and its card into the model cache; return its settings."""
    content = _network(*OUTPUTS[output])
    resources.models_dir().mkdir(parents=True, exist_ok=True)
    (resources.models_dir() / f"{name}.onnx").write_bytes(content)
    card = {
        "name": name, "task": "ground", "family": "tiny", "file": f"{name}.onnx",
        "sha256": hashlib.sha256(content).hexdigest(), "sources": [], "license": "MIT",
        "precision": "fp32", "derived_from": None, "parity": None,
        "input": {"height": HW[0], "width": HW[1]},
        "preprocess": {"color": "rgb", "scale": 1 / 255, "mean": [0] * 3, "std": [1] * 3,
                       "fit": "stretch"},
    }  # fmt: skip
    path = resources.models_dir() / f"{name}.yaml"
    path.write_text(yaml.safe_dump(card | changes))
    return config.OnnxModel(model=name)
