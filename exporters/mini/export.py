"""The trained detector and its phrase encoder as ONNX files, with their cards.

    python -m exporters.mini.export RUN --out models

RUN is the folder of `exporters.train_mini`; the files are made and measured there, on houses that
training never saw. What passes the gate is put into `--out`, with cards that have the hashes and
the figures.
"""

from __future__ import annotations

import argparse
import logging
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
import yaml
from torch import nn

from edge.host.files import replace_atomically
from exporters.calibration import Feed
from exporters.files import ExportError, sha256_of, tells_errors
from exporters.images import as_input
from exporters.mini import checkpoint as checkpoints
from exporters.mini import evaluate, looks
from exporters.mini.batches import PAD
from exporters.mini.net import EMBED_DIM
from exporters.mini.training import FULL_HW, Model
from exporters.mini.views import Frames, make_frames
from exporters.onnx_format import export_module
from exporters.quantize import quantize
from exporters.recipes import recipe_of
from exporters.train_mini import CORES, HOUSES, PER_HOUSE, SEED

FAMILY = "mini-house"
DETECTOR, TEXT, SIMILARITY = (
    f"{FAMILY}-256x320-int8-cpu", f"{FAMILY}-text", f"{FAMILY}-similarity",
)  # fmt: skip
LICENSE = "Apache-2.0"
NOTE = "# Knows only the built-in world. Written by exporters.mini.export."
CALIBRATION_SEEDS, CALIBRATION_FRAMES = range(90_000, 90_032), 2
"""Houses that are neither trained on nor measured on."""


def load_model(checkpoint: Path) -> tuple[Model, dict[str, Any]]:
    """The averaged weights of a training run, and all that its checkpoint says."""
    if not checkpoint.is_file():
        raise ExportError(
            f"{checkpoint}: no checkpoint; run `python -m exporters.train_mini` first"
        )
    kept = checkpoints.load(checkpoint)
    model = Model()
    model.load_state_dict(kept["averaged"])
    return model.eval().requires_grad_(False), kept


def export_detector(detector: nn.Module, out: Path) -> None:
    """FP32, with a static image size and a free number of phrases."""
    images = torch.zeros(1, 3, *FULL_HW)
    text = nn.functional.normalize(torch.ones(1, 3, EMBED_DIM), dim=-1)
    free = {"txt_feats": {1: "prompts"}, "scores": {2: "prompts"}}
    export_module(detector, out, {"images": images, "txt_feats": text}, ("boxes", "scores"), free)


def export_encoder(encoder: nn.Module, out: Path) -> None:
    """With the vocabulary in the file's metadata; see `edge.perception.attributes`."""
    tokens = torch.zeros(2, 3, dtype=torch.int64)
    free = {"tokens": {0: "prompts"}, "embeddings": {0: "prompts"}}
    export_module(encoder, out, {"tokens": tokens}, ("embeddings",), free)
    model = onnx.load(out)
    entry = model.metadata_props.add()
    entry.key, entry.value = "vocabulary", looks.VOCABULARY.to_json()
    with replace_atomically(out) as temporary:
        onnx.save(model, temporary)


def calibration_feeds(frames: Frames, encoder: nn.Module, seed: int = 0) -> list[Feed]:
    """One feed per frame, each with a few phrases of the vocabulary."""
    rng = np.random.default_rng(seed)
    highs = [1 + len(words) for words in (looks.CATEGORIES, looks.COLORS, looks.SIZES)]
    feeds = []
    for rgb in frames.rgb:
        phrases = torch.from_numpy(rng.integers((1, 0, 0), highs, (8, 3)))
        feeds.append({"images": as_input(rgb), "txt_feats": encoder(phrases)[None].numpy()})
    return feeds


def make_cards(folder: Path, measured: dict[str, dict]) -> list[dict]:
    """The three cards, with the hashes of the ONNX files in `folder`."""
    common = {
        "family": FAMILY, "sources": [], "license": LICENSE, "derived_from": None, "parity": None,
    }  # fmt: skip
    of_file = {
        name: {"file": f"{name}.onnx", "sha256": sha256_of(folder / f"{name}.onnx")}
        for name in (DETECTOR, TEXT)
    }
    return [
        {
            "name": DETECTOR, "task": "detect", **common, **of_file[DETECTOR],
            "precision": "int8-cpu", "input": {"height": FULL_HW[0], "width": FULL_HW[1]},
            "preprocess": {"color": "rgb", "scale": 1 / 255, "letterbox_pad": PAD},
            "text_dim": EMBED_DIM, "text_encoder": TEXT, "measured": measured,
        },
        {
            "name": TEXT, "task": "text", **common, **of_file[TEXT],
            "precision": "fp32", "dim": EMBED_DIM, "tokenizer": {"kind": "attributes"},
        },
        {"name": SIMILARITY, "task": "similarity", **common, "detector": DETECTOR},
    ]  # fmt: skip


def publish(made: Path, out: Path, measured: dict[str, dict]) -> None:
    """Put the ONNX files of `made` and their cards into `out`, together: files before cards, and
    nothing at all where one of them cannot be written."""
    contents = {f"{name}.onnx": (made / f"{name}.onnx").read_bytes() for name in (TEXT, DETECTOR)}
    for card in make_cards(made, measured):
        body = yaml.safe_dump(card, sort_keys=False, width=100)
        contents[f"{card['name']}.yaml"] = f"{NOTE}\n{body}".encode()
    with ExitStack() as stack:  # which puts in place first what it was given last
        for name, content in reversed(contents.items()):
            stack.enter_context(replace_atomically(out / name)).write_bytes(content)


def training_figures(kept: dict[str, Any]) -> dict[str, float | int | str]:
    """What the detector's card says of its training, and the command that repeats it."""
    plan, houses = kept["plan"], kept["frames"] // PER_HOUSE
    options = {"seed": (plan["seed"], SEED), "houses": (houses, HOUSES)}
    if kept["device"] == "cpu":
        options["cores"] = (kept["ranks"], CORES)
    said = "".join(f" --{name} {value}" for name, (value, usual) in options.items()
                   if value != usual)  # fmt: skip
    return {
        "command": f"python -m exporters.train_mini --out RUN{said} && "
        "python -m exporters.mini.export RUN",
        "seed": plan["seed"], "houses": houses, "frames": kept["frames"],
        "processes": kept["ranks"], "device": kept["device"], "steps": kept["step"],
        "minutes": round(kept["seconds"] / 60), "torch": kept["torch"], "machine": kept["machine"],
    }  # fmt: skip


def held_out_figures(
    before: evaluate.Report, after: evaluate.Report, bytes_: int
) -> dict[str, float | int]:
    """What the detector's card says of it; `before` is the FP32 model's report."""
    return {
        "first_seed": evaluate.SEEDS[0], "houses": len(evaluate.SEEDS),
        "frames": len(evaluate.SEEDS) * evaluate.PER_HOUSE, **after.summary(),
        "ap50_float32": round(before.map50, 3), "bytes": bytes_,
    }  # fmt: skip


def make_files(run: Path, model: Model) -> dict[str, float | int]:
    """Write the ONNX files into `run`, print what they can do, and return the INT8's figures."""
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


@tells_errors
def main(argv: list[str] | None) -> None:
    parser = argparse.ArgumentParser(prog="python -m exporters.mini.export")
    parser.add_argument("run", type=Path, help="folder of exporters.train_mini")
    parser.add_argument("--out", type=Path, default=Path("models"))
    parser.add_argument(
        "--no-gate", action="store_true", help="put a model in place that is worse than it may be"
    )
    args = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    model, kept = load_model(args.run / "checkpoint.pt")
    held_out = make_files(args.run, model)
    if not args.no_gate:
        evaluate.check_gate(
            held_out, kept["step"], sum(steps for steps, *_ in kept["plan"]["stages"])
        )
    publish(args.run, args.out, {"training": training_figures(kept), "held-out houses": held_out})


if __name__ == "__main__":
    sys.exit(main())
