"""Export of the trained detector and its phrase encoder as ONNX files, with their cards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from torch import nn

from edge.host.files import replace_atomically
from exporters.calibration import Feed
from exporters.files import sha256_of
from exporters.images import as_input
from exporters.onnx_format import export_module
from exporters.quantize import quantize
from exporters.recipes import recipe_of
from exporters.training import checkpoint as checkpoints
from exporters.training.mini import evaluate, looks
from exporters.training.mini.batches import PAD
from exporters.training.mini.net import EMBED_DIM
from exporters.training.mini.training import FULL_HW, Model
from exporters.training.mini.views import PER_HOUSE, Frames, make_frames
from exporters.training.results import publish

FAMILY = "mini-house"
DETECTOR, TEXT, SIMILARITY = (
    f"{FAMILY}-256x320-int8-cpu", f"{FAMILY}-text", f"{FAMILY}-similarity",
)  # fmt: skip
LICENSE = "Apache-2.0"
NOTE = "Knows only the built-in world. Written by exporters.training.mini."
CALIBRATION_SEEDS = range(90_000, 90_032)
"""Seeds of the houses to calibrate the quantization on; no others use them."""
CALIBRATION_FRAMES = 2
"""Images of each of these houses."""


def load_model(checkpoint: Path) -> tuple[Model, dict[str, Any]]:
    """Return the averaged weights of a training run, and its checkpoint."""
    model = Model()
    return model, checkpoints.averaged(checkpoint, model)


def export_detector(detector: nn.Module, out: Path) -> None:
    """Write FP32 ONNX with a static image size and a free number of phrases."""
    images = torch.zeros(1, 3, *FULL_HW)
    text = nn.functional.normalize(torch.ones(1, 3, EMBED_DIM), dim=-1)
    free = {"txt_feats": {1: "prompts"}, "scores": {2: "prompts"}}  # axes of any length
    export_module(detector, out, {"images": images, "txt_feats": text}, ("boxes", "scores"), free)


def export_encoder(encoder: nn.Module, out: Path) -> None:
    """Write ONNX with the vocabulary in its metadata (`edge.perception.embedding.attributes`)."""
    tokens = torch.zeros(2, 3, dtype=torch.int64)
    free = {"tokens": {0: "prompts"}, "embeddings": {0: "prompts"}}
    export_module(encoder, out, {"tokens": tokens}, ("embeddings",), free)
    model = onnx.load(out)
    entry = model.metadata_props.add()
    entry.key, entry.value = "vocabulary", looks.VOCABULARY.to_json()
    with replace_atomically(out) as temporary:
        onnx.save(model, temporary)


def calibration_feeds(frames: Frames, encoder: nn.Module, seed: int = 0) -> list[Feed]:
    """Return one feed per frame, each with a few phrases of the vocabulary."""
    rng = np.random.default_rng(seed)
    highs = [1 + len(words) for words in (looks.CATEGORIES, looks.COLORS, looks.SIZES)]
    feeds = []
    for rgb in frames.rgb:
        phrases = torch.from_numpy(rng.integers((1, 0, 0), highs, (8, 3)))
        feeds.append({"images": as_input(rgb), "txt_feats": encoder(phrases)[None].numpy()})
    return feeds


def make_cards(folder: Path, measured: dict[str, dict]) -> list[dict]:
    """Return the cards of the detector, the phrase encoder, and the similarity of names."""
    common = {
        "family": FAMILY, "sources": [], "license": LICENSE, "derived_from": None, "parity": None,
    }  # fmt: skip
    file_keys = {
        name: {"file": f"{name}.onnx", "sha256": sha256_of(folder / f"{name}.onnx")}
        for name in (DETECTOR, TEXT)
    }
    return [
        {
            "name": DETECTOR, "task": "detect", **common, **file_keys[DETECTOR],
            "precision": "int8-cpu", "input": {"height": FULL_HW[0], "width": FULL_HW[1]},
            "preprocess": {"color": "rgb", "scale": 1 / 255, "letterbox_pad": PAD},
            "text_dim": EMBED_DIM, "text_encoder": TEXT, "measured": measured,
        },
        {
            "name": TEXT, "task": "text", **common, **file_keys[TEXT],
            "precision": "fp32", "dim": EMBED_DIM, "tokenizer": {"kind": "attributes"},
        },
        {"name": SIMILARITY, "task": "similarity", **common, "detector": DETECTOR},
    ]  # fmt: skip


def training_figures(state: dict[str, Any], command: str) -> dict[str, float | int | str]:
    """Return the training entry of the detector's card."""
    return {
        "command": command, "seed": state["plan"]["seed"], "houses": state["frames"] // PER_HOUSE,
        "frames": state["frames"], "processes": state["ranks"], "device": state["device"],
        "steps": state["step"], **checkpoints.made_by(state),
    }  # fmt: skip


def held_out_figures(
    before: evaluate.Report, after: evaluate.Report, bytes_: int
) -> dict[str, float | int]:
    """Return the evaluation entry of the detector's card."""
    return {
        "first_seed": evaluate.SEEDS[0], "houses": len(evaluate.SEEDS),
        "frames": len(evaluate.SEEDS) * evaluate.PER_HOUSE, **after.summary(),
        "ap50_float32": round(before.map50, 3), "bytes": bytes_,
    }  # fmt: skip


def make_files(run: Path, model: Model) -> dict[str, float | int]:
    """Write the ONNX files into `run`, print their figures, and return those of the INT8 file."""
    fp32, text = run / f"{FAMILY}-256x320-fp32.onnx", run / f"{TEXT}.onnx"
    int8, data = run / f"{DETECTOR}.onnx", run / "data"
    export_detector(model.detector, fp32)
    export_encoder(model.encoder, text)
    frames = make_frames(CALIBRATION_SEEDS, CALIBRATION_FRAMES, data)
    quantize(fp32, int8, calibration_feeds(frames, model.encoder), recipe_of(FAMILY), "int8-cpu")
    held_out = evaluate.held_out_frames(data)
    before, after = (evaluate.measure(path, text, held_out) for path in (fp32, int8))
    print(f"float32\n{before.table()}\nint8\n{after.table()}")
    return held_out_figures(before, after, int8.stat().st_size)


def put_in_place(run: Path, out: Path, command: str, gate: bool) -> None:
    """Export the trained model, measure it, and put its files and cards into `out`."""
    model, state = load_model(run / "checkpoint.pt")
    held_out = make_files(run, model)
    if gate:
        steps = sum(steps for steps, *_ in state["plan"]["stages"])
        evaluate.check_gate(held_out, state["step"], steps)
    measured = {"training": training_figures(state, command), "held-out houses": held_out}
    files = {f"{name}.onnx": run / f"{name}.onnx" for name in (TEXT, DETECTOR)}
    publish(files, make_cards(run, measured), out, NOTE)
