"""The trained detector and its phrase encoder as ONNX files, with their cards.

    python -m exporters.mini.export RUN --out models

RUN is the folder of `exporters.train_mini`. The cards get the hashes and what
`exporters.mini.evaluate` measures on houses that training never saw.
"""

from __future__ import annotations

import argparse
import logging
import platform
import sys
import warnings
from pathlib import Path

import numpy as np
import onnx
import torch
import yaml
from torch import Tensor, nn

from exporters.calibration import Feed
from exporters.files import ExportError, replace_atomically, sha256_of
from exporters.mini import evaluate, looks
from exporters.mini.batches import PAD
from exporters.mini.net import EMBED_DIM
from exporters.mini.training import FULL_HW, Model
from exporters.mini.views import Frames, make_frames
from exporters.onnx_format import OPSET, check_format
from exporters.quantize import quantize
from exporters.recipes import recipe_of

FAMILY = "mini-house"
DETECTOR, TEXT, SIMILARITY = (
    f"{FAMILY}-256x320-int8-cpu", f"{FAMILY}-text", f"{FAMILY}-similarity",
)  # fmt: skip
LICENSE = "Apache-2.0"
NOTE = "# Knows only the built-in world. Written by exporters.mini.export."
CALIBRATION_SEEDS, CALIBRATION_FRAMES = range(90_000, 90_032), 2
"""Houses that are neither trained on nor measured on."""


def load_model(checkpoint: Path) -> tuple[Model, int, int]:
    """The averaged weights of a training run, how many steps it has done, and its seed."""
    if not checkpoint.is_file():
        raise ExportError(
            f"{checkpoint}: no checkpoint; run `python -m exporters.train_mini` first"
        )
    kept = torch.load(checkpoint, map_location="cpu", weights_only=True)
    model = Model()
    model.load_state_dict(kept["averaged"])
    return model.eval().requires_grad_(False), int(kept["step"]), int(kept["seed"])


def export_detector(detector: nn.Module, out: Path) -> None:
    """FP32, with a static image size and a free number of phrases."""
    images = torch.zeros(1, 3, *FULL_HW)
    text = nn.functional.normalize(torch.ones(1, 3, EMBED_DIM), dim=-1)
    _export(
        detector, (images, text), out, ["images", "txt_feats"], ["boxes", "scores"],
        {"txt_feats": {1: "prompts"}, "scores": {2: "prompts"}},
    )  # fmt: skip


def export_encoder(encoder: nn.Module, out: Path) -> None:
    """With the vocabulary in the file's metadata; see `edge.perception.attributes`."""
    tokens = torch.zeros(2, 3, dtype=torch.int64)
    _export(
        encoder, (tokens,), out, ["tokens"], ["embeddings"],
        {"tokens": {0: "prompts"}, "embeddings": {0: "prompts"}},
    )  # fmt: skip
    model = onnx.load(out)
    entry = model.metadata_props.add()
    entry.key, entry.value = "vocabulary", looks.VOCABULARY.to_json()
    with replace_atomically(out) as temporary:
        onnx.save(model, temporary)


def _export(
    module: nn.Module, args: tuple[Tensor, ...], out: Path, inputs: list[str],
    outputs: list[str], free: dict[str, dict[int, str]],
) -> None:  # fmt: skip
    with replace_atomically(out) as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # dynamo's graphs do not quantize well
        warnings.simplefilter("ignore", torch.jit.TracerWarning)  # sizes are constants on purpose
        torch.onnx.export(
            module, args, temporary, input_names=inputs, output_names=outputs,
            dynamic_axes=free, opset_version=OPSET, dynamo=False,
        )  # fmt: skip
        check_format(temporary)


def calibration_feeds(frames: Frames, encoder: nn.Module, seed: int = 0) -> list[Feed]:
    """One feed per frame, each with a few phrases of the vocabulary."""
    rng = np.random.default_rng(seed)
    highs = [1 + len(words) for words in (looks.CATEGORIES, looks.COLORS, looks.SIZES)]
    feeds = []
    for rgb in frames.rgb:
        phrases = torch.from_numpy(rng.integers((1, 0, 0), highs, (8, 3)))
        feeds.append(
            {"images": evaluate.as_input(rgb), "txt_feats": encoder(phrases)[None].numpy()}
        )
    return feeds


def write_cards(folder: Path, measured: dict) -> None:
    """The three cards, with the hashes of the files that lie in `folder` already."""
    common = {
        "family": FAMILY, "sources": [], "license": LICENSE, "derived_from": None, "parity": None,
    }  # fmt: skip
    of_file = {
        name: {"file": f"{name}.onnx", "sha256": sha256_of(folder / f"{name}.onnx")}
        for name in (DETECTOR, TEXT)
    }
    cards = (
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
    )  # fmt: skip
    for card in cards:
        with replace_atomically(folder / f"{card['name']}.yaml") as temporary:
            body = yaml.safe_dump(card, sort_keys=False, width=100)
            temporary.write_text(f"{NOTE}\n{body}", encoding="utf-8")


def measured_figures(
    step: int, seed: int, before: evaluate.Report, after: evaluate.Report, bytes_: int
) -> dict[str, dict[str, float | int | str]]:
    """What the detector's card says of it; `before` is the FP32 model's report."""
    return {
        "training": {
            "command": "python -m exporters.train_mini --out RUN && "
            "python -m exporters.mini.export RUN",
            "seed": seed, "steps": step, "torch": str(torch.__version__),
            "machine": platform.machine(),
        },
        "held-out houses": {
            "first_seed": evaluate.SEEDS[0], "houses": len(evaluate.SEEDS),
            "frames": len(evaluate.SEEDS) * evaluate.PER_HOUSE, **after.summary(),
            "ap50_float32": round(before.map50, 3), "bytes": bytes_,
        },
    }  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m exporters.mini.export")
    parser.add_argument("run", type=Path, help="folder of exporters.train_mini")
    parser.add_argument("--out", type=Path, default=Path("models"))
    args = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    try:
        model, step, seed = load_model(args.run / "checkpoint.pt")
        fp32 = args.run / f"{FAMILY}-256x320-fp32.onnx"
        export_detector(model.detector, fp32)
        export_encoder(model.encoder, args.out / f"{TEXT}.onnx")
        frames = make_frames(CALIBRATION_SEEDS, CALIBRATION_FRAMES, args.run / "data")
        int8 = args.out / f"{DETECTOR}.onnx"
        feeds = calibration_feeds(frames, model.encoder)
        quantize(fp32, int8, feeds, recipe_of(FAMILY), "int8-cpu")
        held_out = evaluate.held_out_frames(args.run / "data")
        before = evaluate.measure(fp32, args.out / f"{TEXT}.onnx", held_out)
        after = evaluate.measure(int8, args.out / f"{TEXT}.onnx", held_out)
    except ExportError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"float32\n{before.table()}\nint8\n{after.table()}")
    write_cards(args.out, measured_figures(step, seed, before, after, int8.stat().st_size))
    return 0


if __name__ == "__main__":
    sys.exit(main())
