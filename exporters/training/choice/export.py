"""Export of the choice model as one ONNX file, with its card.

The file joins the detector's trunk and the trained net. The trunk stays INT8, as the quantizer made
the detector. The net stays float32: it has a tenth of the weights, and was trained on the INT8
trunk's output.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import onnx
import torch
import yaml
from onnx import compose
from torch import Tensor, nn

from edge.host.files import replace_atomically
from edge.perception.runtime.card_types import MARK_FIELDS, OTHERS_FIELDS
from edge.perception.scoring.choice.question import MAX_MARKS
from exporters.files import ExportError, sha256_of
from exporters.onnx_format import check_format, export_module
from exporters.training import checkpoint as checkpoints
from exporters.training.choice import evaluate
from exporters.training.choice.collect import HW, load_views
from exporters.training.choice.features import GRID_HW, HEADS, NECK, Trunk, make_features
from exporters.training.choice.net import NECK16_CHANNELS, NECK32_CHANNELS, ChoiceNet
from exporters.training.choice.training import Data
from exporters.training.mini import looks
from exporters.training.mini.batches import PAD
from exporters.training.mini.net import EMBED_DIM
from exporters.training.results import MODELS, publish

NAME, DETECTOR, TEXT = "mini-house-choice", "mini-house-256x320-int8-cpu", "mini-house-text"
DETECTOR_FILE, TEXT_FILE = MODELS / f"{DETECTOR}.onnx", MODELS / f"{TEXT}.onnx"
NOTE = "Knows only the built-in world. Written by exporters.training.choice."
MAX_LOGIT_ERROR = 0.05
"""Largest allowed difference of the joined file's logits from the net's. The net reads stored
features, whose scores have 8 bits."""
_PREFIX = "net/"  # of the names of the net's nodes and tensors in the joined file
_INPUTS = ("txt_feats", "marks", "others")  # of the file, in addition to the trunk's


class Head(nn.Module):
    """The part after the trunk: the detector's scores in each cell, and the net."""

    def __init__(self, net: ChoiceNet, trunk: Trunk) -> None:
        super().__init__()
        self.net, self.scale, self.bias = net, trunk.logit_scale, trunk.logit_bias
        self.register_buffer("words", torch.from_numpy(trunk.words))  # (kinds, EMBED_DIM)

    def forward(
        self,
        embed8: Tensor,
        embed16: Tensor,
        embed32: Tensor,
        neck16: Tensor,
        neck32: Tensor,
        txt_feats: Tensor,
        marks: Tensor,
        others: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Return the logits of directions (1, MAX_MARKS + 1) and scene (1, 1).

        A number in a name is a stride. The image has h x w pixels.

        Args:
            embed8: (1, EMBED_DIM, h / 8, w / 8), first of `features.HEADS`.
            embed16: (1, EMBED_DIM, h / 16, w / 16), second of `features.HEADS`.
            embed32: (1, EMBED_DIM, h / 32, w / 32), third of `features.HEADS`.
            neck16: (1, NECK16_CHANNELS, h / 16, w / 16), first of `features.NECK`.
            neck32: (1, NECK32_CHANNELS, h / 32, w / 32), second of `features.NECK`.
            txt_feats: (1, EMBED_DIM) embedding of the target.
            marks: (1, MAX_MARKS, MARK_FIELDS), position, bearing, distance, path and gain of each
                mark; see `labels.marks_of`.
            others: (1, OTHERS_FIELDS), figures of the frontiers without a mark; see `Views`.
        """
        words = torch.cat([self.words, txt_feats])
        best = None  # highest score of each word in each cell of the feature grid
        for grid in (embed8, embed16, embed32):
            h, w = grid.shape[2:]
            score = (words @ grid.flatten(2)).reshape(1, -1, h, w)
            pooled = nn.functional.max_pool2d(score, (h // GRID_HW[0], w // GRID_HW[1]))
            best = pooled if best is None else torch.maximum(best, pooled)
        scores = torch.sigmoid(self.scale * best + self.bias)
        kinds = self.words.shape[0]
        seen = self.net.read(nn.functional.avg_pool2d(neck16, 2), neck32, scores[:, :kinds])
        target = scores[:, kinds:].flatten(2)
        directions, scene = self.net(seen, target, txt_feats[None], marks, others)
        return directions.reshape(1, -1), scene


def export(net: ChoiceNet, trunk: Trunk, out: Path) -> None:
    """Write the joined model."""
    (h, w), (gh, gw) = HW, GRID_HW
    shapes = ((EMBED_DIM, h // 8, w // 8), (EMBED_DIM, h // 16, w // 16), (EMBED_DIM, gh, gw),
              (NECK16_CHANNELS, 2 * gh, 2 * gw), (NECK32_CHANNELS, gh, gw))  # fmt: skip
    names = ("embed8", "embed16", "embed32", "neck16", "neck32")
    inputs = {name: torch.zeros(1, *shape) for name, shape in zip(names, shapes, strict=True)}
    inputs["txt_feats"] = torch.zeros(1, EMBED_DIM)
    inputs["marks"] = torch.zeros(1, MAX_MARKS, MARK_FIELDS)
    inputs["others"] = torch.zeros(1, OTHERS_FIELDS)
    head = out.with_suffix(".head.onnx")
    export_module(Head(net, trunk).eval(), head, inputs, ("directions", "scene"), {})
    joined = compose.merge_models(
        _at_version(trunk.model, onnx.load(head)), compose.add_prefix(onnx.load(head), _PREFIX),
        [(tensor, _PREFIX + name) for tensor, name in zip((*HEADS, *NECK), names, strict=True)],
    )  # fmt: skip
    _rename(joined, {_PREFIX + n: n for n in (*_INPUTS, "directions", "scene")})
    with replace_atomically(out) as part:
        onnx.save(joined, part)
        check_format(part)
    head.unlink()


def _at_version(model: onnx.ModelProto, like: onnx.ModelProto) -> onnx.ModelProto:
    """Return a copy of `model` that declares the versions of `like`, as a merge requires.

    This is safe because the operators are the same; only the file format's version differs.
    """
    copy = onnx.ModelProto()
    copy.CopyFrom(model)
    copy.ir_version = like.ir_version
    del copy.opset_import[:]
    copy.opset_import.extend(like.opset_import)
    return copy


def _rename(model: onnx.ModelProto, names: dict[str, str]) -> None:
    """Rename tensors of a model in place, from key to value."""
    graph = model.graph
    for value in (*graph.input, *graph.output):
        value.name = names.get(value.name, value.name)
    for node in graph.node:
        for ends in (node.input, node.output):
            ends[:] = [names.get(name, name) for name in ends]


def make_card(path: Path, measured: dict[str, dict]) -> dict[str, Any]:
    """Return the card of a file."""
    return {
        "name": NAME, "task": "marks", "family": "mini-house", "sources": [],
        "license": "Apache-2.0", "derived_from": None, "parity": None,
        "file": f"{NAME}.onnx", "sha256": sha256_of(path), "precision": "int8-cpu",
        "input": {"height": HW[0], "width": HW[1]},
        "preprocess": {"color": "rgb", "scale": 1 / 255, "letterbox_pad": PAD},
        "text_dim": EMBED_DIM, "text_encoder": TEXT, "measured": measured,
    }  # fmt: skip


def held_out_figures(
    net: ChoiceNet, trunk: Trunk, model: Path, paths: list[Path]
) -> dict[str, Any]:
    """Return the card's figures on held-out houses.

    Raises:
        ExportError: the file's answers differ from the net's.
    """
    views = load_views(paths)
    data = Data(views, make_features(paths, trunk), trunk.level_scales, trunk.words)
    logits = evaluate.logits_of(net, data, views)
    logit_error = evaluate.parity(model, views, trunk.words, logits)
    if logit_error > MAX_LOGIT_ERROR:
        raise ExportError(
            f"{model}: not published: logits of the ONNX file differ by {logit_error:.3f} from the "
            f"network's, allowed {MAX_LOGIT_ERROR:g}"
        )
    return {
        "first_seed": int(views.house.min()), "houses": len(set(views.house.tolist())),
        "views": len(views), **evaluate.top1(views, logits),
        "scene_auc": round(evaluate.scene_auc(views, logits), 3),
        "logit_error": round(logit_error, 4), "bytes": model.stat().st_size,
        **evaluate.latency_ms(model),
    }  # fmt: skip


def put_in_place(run: Path, out: Path, command: str, houses: int) -> None:
    """Export the trained model, measure it on the views in `held-out`, and publish it."""
    net = ChoiceNet(len(looks.CATEGORIES))
    state = checkpoints.averaged(run / "checkpoint.pt", net)
    trunk, model = Trunk(DETECTOR_FILE, TEXT_FILE), run / f"{NAME}.onnx"
    # `SEED.npz` holds views; `SEED.HASH.npz` next to it, their features, is left out.
    paths = [path for path in (run / "held-out").glob("*.npz") if path.stem.isdigit()]
    export(net, trunk, model)
    training = {
        "command": command, "seed": state["plan"]["seed"], "houses": houses,
        "views": state["frames"], "steps": state["step"], **checkpoints.made_by(state),
        "trunk": DETECTOR,
    }  # fmt: skip
    figures = held_out_figures(net, trunk, model, sorted(paths))
    measured = {"training": training, "held-out houses": figures}
    publish({f"{NAME}.onnx": model}, [make_card(model, measured)], out, NOTE)
    print(yaml.safe_dump(measured, sort_keys=False))
