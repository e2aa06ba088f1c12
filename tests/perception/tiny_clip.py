"""CLIP's encoders and a detector in miniature: ONNX files, a tokenizer, and cards."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import yaml
from onnx_text import onnx_of, tiny_detector

WORDS = ("chair", "sofa", "red", "seems", "like", "there", "is", "a", "ahead")
DIM, CONTEXT, SIDE = 16, 12, 32
TEXT = {
    "name": "tiny-clip-text", "family": "clip-vit-b-32", "task": "text", "file": "tiny-text.onnx",
    "sources": [], "license": "CC0-1.0", "precision": "fp32", "derived_from": None,
    "parity": None, "dim": DIM,
    "tokenizer": {
        "kind": "clip", "file": "tiny-tokenizer.json", "sha256": None, "context": CONTEXT,
    },
}  # fmt: skip
IMAGE = {
    **{k: v for k, v in TEXT.items() if k != "tokenizer"},
    "name": "tiny-clip-image", "task": "image", "file": "tiny-image.onnx",
    "input": {"height": SIDE, "width": SIDE},
    "preprocess": {"color": "rgb", "scale": 1 / 255, "mean": [0.0] * 3, "std": [1.0] * 3},
}  # fmt: skip
PAIR = {
    "name": "tiny-clip-similarity", "family": "tiny-clip", "task": "similarity",
    "license": "CC0-1.0", "image_encoder": "tiny-clip-image", "text_encoder": "tiny-clip-text",
}  # fmt: skip


DETECTOR = {
    **{k: v for k, v in TEXT.items() if k not in ("tokenizer", "dim")},
    "name": "tiny-detector", "task": "detect", "file": "tiny-detector.onnx",
    "input": {"height": SIDE, "width": SIDE}, "text_dim": 512,
    "preprocess": {"color": "rgb", "scale": 1 / 255, "letterbox_pad": 114},
}  # fmt: skip
BY_DETECTOR = {
    "name": "tiny-by-detector", "family": "tiny", "task": "similarity", "license": "CC0-1.0",
    "detector": "tiny-detector",
}  # fmt: skip


def write_tokenizer(path: Path) -> None:
    """One token per word; 0 is nothing, 1 begins, 2 is any other word, the last one ends."""
    from tokenizers import Tokenizer, models, pre_tokenizers, processors

    vocabulary = {"<|startoftext|>": 1, "?": 2} | {w: 3 + i for i, w in enumerate(WORDS)}
    end = vocabulary["<|endoftext|>"] = len(vocabulary) + 1
    tokenizer = Tokenizer(models.WordLevel(vocabulary, unk_token="?"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer.post_processor = processors.TemplateProcessing(
        single="<|startoftext|> $A <|endoftext|>",
        special_tokens=[("<|startoftext|>", 1), ("<|endoftext|>", end)],
    )
    tokenizer.enable_padding(length=3)  # as published files may; the encoder must not
    tokenizer.enable_truncation(3)
    tokenizer.save(str(path))


def write_text_model(path: Path, table: np.ndarray | None = None, name: str = "tokens") -> None:
    """Write a model that sums one row of `table` for each token: token i counts on axis i."""
    if table is None:
        table = np.eye(len(WORDS) + 4, DIM, dtype=np.float32)
        table[:3] = 0.0
    text = f"""g (int64[n,{CONTEXT}] {name}) => (float[n,{table.shape[1]}] embeddings) {{
      rows = Gather <axis = 0> (table, {name})
      embeddings = ReduceSum <keepdims = 0> (rows, axes)
    }}"""
    path.write_bytes(onnx_of(text, table=table, axes=[1]))


def write_image_model(path: Path) -> None:
    """Mean red counts for "chair", mean green for "sofa", mean blue for "red"; 1 for "is"."""
    spread = np.zeros((3, DIM), np.float32)
    spread[[0, 1, 2], [3, 4, 5]] = 1.0
    always = np.zeros((1, DIM), np.float32)
    always[0, 3 + WORDS.index("is")] = 1e-3  # a black image has a direction too
    text = f"""g (float[1,3,{SIDE},{SIDE}] pixels) => (float[1,{DIM}] embeddings) {{
      mean = ReduceMean <axes = [2, 3], keepdims = 0> (pixels)
      colours = MatMul (mean, spread)
      embeddings = Add (colours, always)
    }}"""
    path.write_bytes(onnx_of(text, spread=spread, always=always))


def write_detector(path: Path, logits: np.ndarray) -> None:
    """Two empty boxes; scores are the sigmoid of `logits` (2, 512) times the text features."""
    path.write_bytes(tiny_detector(np.zeros((1, 2, 4), np.float32), logits, (SIDE, SIDE)))


def write_card(folder: Path, card: dict, file: Path | None = None) -> None:
    """Write the card under its name, with the present hash of the model's file."""
    if file is not None:
        card = {**card, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
    (folder / f"{card['name']}.yaml").write_text(yaml.safe_dump(card))
