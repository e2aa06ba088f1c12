"""Export of CLIP and SigLIP from a Hugging Face folder to ONNX, with cards.

    edge models export NAME --weights FOLDER --precision fp32 int8-cpu --calibration PICTURES

Such a model has two encoders (towers), for images and for texts. For each precision this writes
`NAME-image-PRECISION`, `NAME-text-PRECISION`, and `NAME-PRECISION`, the card of the scorer that
uses both. `edge.perception.embedding.clip` describes the files.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from edge import names
from edge.host.files import replace_atomically, write_atomically
from edge.perception.embedding.clip import pixels_of
from edge.perception.runtime.card_types import ImageCard, TextCard
from edge.perception.scoring.similarity import SENTENCE
from edge.text import one_line
from exporters import hugging_face
from exporters.encoder_parity import LIMITS, EmbeddingReport, compare
from exporters.files import ExportError, sha256_of, write_card
from exporters.images import PROMPTS, digest_of, read_rgb
from exporters.onnx_format import cpu_session, export_module
from exporters.quantize import derive, pictures, precisions_to_make
from exporters.recipes import TRANSFORMER
from exporters.sidecar import write_sidecar

TEXT_PRECISION = {"fp32": "fp32", "fp16": "fp16", "int8-cpu": "int8"}
"""Precision of the text tower, by that of the image tower. A text is encoded once per mission, so
its size matters more than its speed."""
LEGACY_END = 2
"""Wrong end-of-text id in old configurations of CLIP. Those models end a text with the token of the
highest id."""


class ImageTower(nn.Module):
    """Image encoder: `pixels` (1, 3, h, w) float32 → `embeddings` (1, d) float32."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.vision_model = model.vision_model
        self.projection = getattr(model, "visual_projection", nn.Identity())

    def forward(self, pixels: Tensor) -> Tensor:
        return self.projection(self.vision_model(pixel_values=pixels).pooler_output)


class ClipTextTower(nn.Module):
    """CLIP's text encoder: `tokens` (n, context) int64 → `embeddings` (n, d) float32.

    An embedding is that of the first end-of-text token.
    """

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.text_model, self.projection = model.text_model, model.text_projection
        end = model.config.text_config.eos_token_id
        self.end = None if end == LEGACY_END else end
        context = model.config.text_config.max_position_embeddings
        # A finite number: -inf would overflow in float16.
        mask = torch.full((context, context), -1e4).triu(1)[None, None]
        self.register_buffer("causal", mask, persistent=False)

    def forward(self, tokens: Tensor) -> Tensor:
        hidden = self.text_model.embeddings(input_ids=tokens)
        encoded = self.text_model.encoder(inputs_embeds=hidden, attention_mask=self.causal)
        rows = self.text_model.final_layer_norm(encoded.last_hidden_state)
        # argmax gives the first end-of-text token: the first 1, or with LEGACY_END the highest id.
        is_end = tokens if self.end is None else (tokens == self.end).to(torch.int32)
        place = is_end.argmax(dim=-1)[:, None, None].expand(-1, 1, rows.shape[-1])
        return self.projection(rows.gather(1, place)[:, 0])


class SiglipTextTower(nn.Module):
    """SigLIP's text encoder: it sees all positions, and its embedding is that of the last one."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.text_model = model.text_model

    def forward(self, tokens: Tensor) -> Tensor:
        hidden = self.text_model.embeddings(input_ids=tokens)
        encoded = self.text_model.encoder(inputs_embeds=hidden, attention_mask=None)
        rows = self.text_model.final_layer_norm(encoded.last_hidden_state)
        return self.text_model.head(rows[:, -1])


@dataclass(frozen=True)
class Family:
    """One architecture.

    Attributes:
        model: class of `transformers`.
        pads: True if the model also attends to the padding of a text.
    """

    model: str
    text_tower: type[nn.Module]
    pads: bool


FAMILIES = {
    "clip": Family("CLIPModel", ClipTextTower, pads=False),
    "siglip": Family("SiglipModel", SiglipTextTower, pads=True),
}
"""Architectures by `model_type`. SigLIP 2 checkpoints of one resolution are also `siglip`."""


def load_towers(folder: Path) -> tuple[ImageTower, nn.Module]:
    """Return the image and text towers of a folder."""
    import transformers

    family = _family(folder)
    model = hugging_face.load(getattr(transformers, family.model), folder)
    return ImageTower(model).eval(), family.text_tower(model).eval()


def _family(folder: Path) -> Family:
    """Return the architecture of a folder."""
    return FAMILIES[hugging_face.model_type(folder)]


def export(args: Any) -> dict[str, EmbeddingReport | None]:
    """Make all files and cards that were asked for; return the parity by card, None if unknown.

    `exporters.__main__` explains the arguments.
    """
    folder: Path = args.weights
    wanted = precisions_to_make(args, TEXT_PRECISION, "image and text encoders")
    calibration, validation = pictures(args.calibration, args.validation)
    towers = load_towers(folder)
    write_atomically(
        args.cache / f"{args.card}-tokenizer.json",
        hugging_face.tokenizer_text(folder, lowercase=_family(folder).pads).encode(),
    )
    cards = {p: make_cards(folder, p, towers, args) for p in wanted}
    image_card = ImageCard.model_validate(cards["fp32"][0])
    tokens = tokens_of(TextCard.model_validate(cards["fp32"][1]), args.cache, sentences())
    vocabulary = towers[1].text_model.config.vocab_size
    hugging_face.check_tokens(folder, tokens.ravel().tolist(), vocabulary)
    texts = [row[None] for row in tokens]
    to_calibrate, to_compare = (
        ([pixels_of(read_rgb(path), image_card) for path in calibration], texts),
        ([pixels_of(read_rgb(path), image_card) for path in validation], texts),
    )
    # `compare` ranks images by texts, and texts by images.
    image_rows, text_rows = map(embed_torch, towers, to_compare)
    others = (text_rows, image_rows)
    weights_sha256 = hugging_face.weights_sha256(folder)
    digests = (digest_of(calibration) if calibration else None, None)
    reports: dict[str, EmbeddingReport | None] = {}
    for precision in wanted:
        for k, tower in enumerate(towers):  # the third card, of the pair, has no file
            card = cards[precision][k]
            reports[card["name"]] = make_encoder(
                card, tower, to_calibrate[k], to_compare[k], weights_sha256, args, others[k],
                digests[k],
            )  # fmt: skip
        for card in cards[precision]:
            write_card(card, args.cache)
    return reports


def make_cards(
    folder: Path, precision: str, towers: tuple[nn.Module, nn.Module], args: Any
) -> list[dict[str, Any]]:
    """Return the cards of the image tower, the text tower and the pair, in one precision."""
    image, text = (
        f"{args.card}-image-{precision}",
        f"{args.card}-text-{TEXT_PRECISION[precision]}",
    )
    context = towers[1].text_model.config.max_position_embeddings
    common = {
        "family": args.family or args.card, "sources": [],
        "license": args.license or hugging_face.license_of(folder),
    }  # fmt: skip
    not_measured = {"sha256": None, "parity": None}
    tokenizer = f"{args.card}-tokenizer.json"
    # `derived_from` of the image tower and of the text tower.
    derived = (None, None) if precision == "fp32" else (
        f"{args.card}-image-fp32", f"{args.card}-text-fp32",
    )  # fmt: skip
    with torch.inference_mode():
        dim = int(towers[1](torch.zeros(1, context, dtype=torch.int64)).shape[1])
    return [
        {
            "name": image, "task": "image", **common, **not_measured, "file": f"{image}.onnx",
            "precision": precision, "derived_from": derived[0], **image_preprocess(folder),
            "dim": dim,
        },
        {
            "name": text, "task": "text", **common, **not_measured, "file": f"{text}.onnx",
            "precision": TEXT_PRECISION[precision], "derived_from": derived[1], "dim": dim,
            "tokenizer": {
                "kind": "clip", "file": tokenizer, "context": context,
                "sha256": sha256_of(args.cache / tokenizer),
                "pad": hugging_face.pad_token(folder) if _family(folder).pads else 0,
            },
        },
        {
            "name": f"{args.card}-{precision}", "task": "similarity", **common,
            "image_encoder": image, "text_encoder": text,
        },
    ]  # fmt: skip


def image_preprocess(folder: Path) -> dict[str, Any]:
    """Return `input` and `preprocess` of an image card, from `preprocessor_config.json`.

    Raises:
        ExportError: it needs more than a resize, a crop and a normalization.
    """
    path = folder / "preprocessor_config.json"
    settings = hugging_face.read_json(path)
    size = _height_width(settings.get("size"), path)
    crops = bool(settings.get("do_center_crop"))
    if crops and _height_width(settings.get("crop_size"), path) != size:
        raise ExportError(
            f"{path}: crop_size must equal size, because the service supports no other crop"
        )
    if not crops and "shortest_edge" in (settings.get("size") or {}):
        raise ExportError(f"{path}: do_center_crop must be true if size gives shortest_edge")
    mean, std = settings.get("image_mean", [0.0] * 3), settings.get("image_std", [1.0] * 3)
    if not settings.get("do_normalize", True):
        mean, std = [0.0] * 3, [1.0] * 3
    return {
        "input": {"height": size[0], "width": size[1]},
        "preprocess": {
            "color": "rgb", "scale": float(settings.get("rescale_factor", 1 / 255)),
            "mean": [float(m) for m in mean], "std": [float(s) for s in std],
            "fit": "crop" if crops else "stretch",
        },
    }  # fmt: skip


def _height_width(size: Any, path: Path) -> tuple[int, int]:
    """Return height and width of a size in any of the processors' forms."""
    if isinstance(size, int):
        return size, size
    if isinstance(size, dict):
        if isinstance(edge := size.get("shortest_edge"), int):
            return edge, edge
        if isinstance(size.get("height"), int) and isinstance(size.get("width"), int):
            return size["height"], size["width"]
    raise ExportError(f"{path}: size: got {one_line(size)}; give height and width in px")


def sentences() -> list[str]:
    """Return the sentences that a text tower is compared on: VLFM's prompt with common targets."""
    return [SENTENCE.format(names.normalise(word)) for word in PROMPTS.split(",")]


def tokens_of(card: TextCard, folder: Path, texts: list[str]) -> np.ndarray:
    """Return texts as tokens of a card's model, (n, context) int64."""
    tokenizer = hugging_face.open_tokenizer(folder / card.tokenizer.file)
    tokenizer.no_padding()
    tokenizer.no_truncation()
    tokens = np.full((len(texts), card.tokenizer.context), card.tokenizer.pad, np.int64)
    for row, text in zip(tokens, texts, strict=True):
        ids = tokenizer.encode(text).ids[: len(row)]
        row[: len(ids)] = ids
    return tokens


def make_encoder(
    card: dict[str, Any],
    tower: nn.Module,
    to_calibrate: list[np.ndarray],
    to_compare: list[np.ndarray],
    weights_sha256: str,
    args: Any,
    others: np.ndarray | None = None,
    calibration_sha256: str | None = None,
) -> EmbeddingReport | None:
    """Make the file and the sidecar of an encoder; return None if there is nothing to compare on.

    A precision other than FP32 is made from the FP32 file in the cache.

    Args:
        card: image card or text card.
        tower: the original: `pixels` or `tokens` → `embeddings`.
        to_calibrate: inputs of the tower, each with a first axis of 1.
        to_compare: the same, to compare the file with the tower on.
        weights_sha256: hash of the original's weights.
        args: see `exporters.__main__`.
        others: (m, d) embeddings by the other tower, see `compare`.
        calibration_sha256: hash of the pictures behind `to_calibrate`.
    """
    out, precision, source = args.cache / card["file"], card["precision"], card["derived_from"]
    name = "pixels" if card["task"] == "image" else "tokens"
    print(f"{card['name']}: exporting {out}", file=sys.stderr)
    report = None
    with replace_atomically(out) as temporary:
        if source is not None:
            feeds = [{name: row} for row in to_calibrate]
            derive(args.cache / f"{source}.onnx", temporary, feeds, TRANSFORMER, precision)
        elif name == "pixels":
            pixels = torch.zeros(1, 3, card["input"]["height"], card["input"]["width"])
            export_module(tower, temporary, {name: pixels}, ("embeddings",), {})
        else:
            tokens = torch.from_numpy(np.concatenate(to_compare[:2]))
            free = {name: {0: "n"}, "embeddings": {0: "n"}}  # any number of texts
            export_module(tower, temporary, {name: tokens}, ("embeddings",), free)
        if to_compare:
            found = embed_onnx(temporary, to_compare)
            report = compare(embed_torch(tower, to_compare), found, others)
            report.accept(card["name"], "torch", None if args.no_gate else LIMITS[precision])
    parity = report.for_card("torch") if report else None
    digest = None if source is None else calibration_sha256
    write_sidecar(out, card["name"], parity, weights_sha256, digest)
    return report


def embed_torch(tower: nn.Module, inputs: list[np.ndarray]) -> np.ndarray:
    """Return (n, d): one embedding for each input."""
    with torch.inference_mode():
        rows = [tower(torch.from_numpy(batch)).numpy() for batch in inputs]
    return np.concatenate(rows) if rows else np.empty((0, 0), np.float32)


def embed_onnx(path: Path, inputs: list[np.ndarray]) -> np.ndarray:
    """Return (n, d): one embedding for each input, by an ONNX file on the CPU."""
    session = cpu_session(path, threads=2)
    name = session.get_inputs()[0].name
    return np.concatenate([session.run(["embeddings"], {name: batch})[0] for batch in inputs])
