"""Vision-language models from a Hugging Face folder to three ONNX files, as they are published.

    edge models export NAME --weights FOLDER --precision q4 --calibration PICTURES

writes `NAME/onnx/vision_encoder…`, `embed_tokens…` and `decoder_model_merged….onnx` with the
suffixes of published files, what says how to feed them beside, and a card for each precision. Keys
and values of what was read go in and out of the decoder: one file reads a prompt and goes on.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import onnx
import torch
import yaml
from torch import nn

from edge.host.files import read_regular, replace_atomically, write_atomically
from edge.text import one_line
from exporters import hugging_face
from exporters.encoder_parity import Tolerance, check_tolerance
from exporters.files import ExportError
from exporters.fp16 import kept_nodes, to_fp16
from exporters.images import digest_of, read_rgb
from exporters.onnx_format import check_format, trace_module
from exporters.quantize import need_pictures, pictures, quantize
from exporters.recipes import TRANSFORMER, Recipe, nodes_like
from exporters.sidecar import write_sidecar
from exporters.vlm_networks import Decoder, Embedding, Idefics3Vision, Qwen2Vision
from exporters.vlm_parity import (
    Chain,
    LetterReport,
    Original,
    Question,
    cache_shape,
    letter_logits,
    measure,
    questions,
)
from exporters.weight_only import quantize_weights

VISION, EMBEDDING, DECODER = FILES = ("vision_encoder", "embed_tokens", "decoder_model_merged")
PRECISIONS = {
    "fp32": ("fp32", "fp32", "fp32"),
    "fp16": ("fp16", "fp16", "fp16"),
    "int8": ("int8", "int8", "int8"),
    "q4": ("int8", "int8", "q4"),
    "q4f16": ("fp16", "fp16", "q4f16"),
}
"""By a card's precision: those of its files. `int8` is static of the vision encoder, and of weights
alone of the others; `q4` of weights."""
TOLERANCES = {
    "fp32": Tolerance(cosine=0.9999, rank_agreement=0.99),
    "fp16": Tolerance(cosine=0.999, rank_agreement=0.97),
    "int8": Tolerance(cosine=0.9, rank_agreement=0.9),
    "q4": Tolerance(cosine=0.9, rank_agreement=0.8),
    "q4f16": Tolerance(cosine=0.999, rank_agreement=0.8),
}
CACHED = ("past_key_values.", "present.")
RECIPES = {
    VISION: Recipe(not_fp16=(r"^/places/",)),
    EMBEDDING: Recipe(),
    DECODER: Recipe(not_fp16=(r"^/rotary_emb/", r"layernorm/", r"^/norm/")),
}
"""What stays in float32: the angle of place 1000 has no fraction left in float16, and the square of
a decoder's hidden value soon is no number."""
ONE_FILE_BYTES = 2_000_000_000
"""What is more is kept in a file beside: protocol buffers end at 2 GiB."""
OTHERS = (
    "config.json", "tokenizer.json", "tokenizer_config.json", "preprocessor_config.json",
    "processor_config.json", "chat_template.jinja", "chat_template.json",
)  # fmt: skip
"""What says how to feed the networks, as far as the folder has it."""
TRACED_TOKENS, TRACED_PAST = 3, 2
HALF_PICTURES = 8
"""On so many it is seen which of the decoder's values are too large for float16."""


class Networks(NamedTuple):
    """The three of a model, and how its images are prepared.

    Attributes:
        prepare: (h, w, 3) uint8 → inputs of the vision encoder, by name.
        text: configuration of the language model.
        threefold: places have three numbers (M-RoPE).
    """

    vision: nn.Module
    embedding: nn.Module
    decoder: nn.Module
    prepare: Callable[[np.ndarray], dict[str, np.ndarray]]
    text: Any
    threefold: bool


@dataclass(frozen=True)
class Family:
    """One architecture.

    Attributes:
        prefix: of the names of its classes in `transformers`.
        vision: its vision encoder.
        text: where the model keeps its language model.
        threefold: places have three numbers (M-RoPE).
    """

    prefix: str
    vision: type[nn.Module]
    text: str
    threefold: bool = False


FAMILIES = {
    "idefics3": Family("Idefics3", Idefics3Vision, "text_model"),
    "smolvlm": Family("SmolVLM", Idefics3Vision, "text_model"),
    "qwen2_vl": Family("Qwen2VL", Qwen2Vision, "language_model", threefold=True),
}
"""By `model_type`; SmolVLM 2 calls itself `smolvlm`, SmolVLM `idefics3`."""


def load_model(folder: Path) -> tuple[nn.Module, Networks]:
    """The model of a folder and its networks.

    Raises:
        ExportError: the folder cannot be used, or does what a trace cannot follow.
    """
    import transformers

    kind = hugging_face.model_type(folder)
    if kind not in FAMILIES:
        choices = ", ".join(FAMILIES)
        raise ExportError(f"{folder}: model_type: {one_line(kind)!r} (choices: {choices})")
    family = FAMILIES[kind]
    model = hugging_face.load(
        getattr(transformers, f"{family.prefix}ForConditionalGeneration"), folder
    )
    text = getattr(model.model, family.text)
    rope = text.rotary_emb.rope_type
    if rope in ("dynamic", "longrope"):
        raise ExportError(f"{folder}: rope_type {rope!r} goes by the length, and is not exported")
    if getattr(text.config, "use_sliding_window", False):
        raise ExportError(f"{folder}: use_sliding_window is not exported; set it to false")
    processor = _image_processor(folder, family)

    def prepare(rgb: np.ndarray) -> dict[str, np.ndarray]:
        if family.threefold:
            found = processor(images=[rgb], return_tensors="np")
            return {"pixel_values": found["pixel_values"], "grid_thw": found["image_grid_thw"]}
        found = processor(images=[[rgb]], do_image_splitting=False, return_tensors="np")
        mask = found["pixel_attention_mask"].astype(bool)
        return {"pixel_values": found["pixel_values"], "pixel_attention_mask": mask}

    networks = Networks(
        family.vision(model.model).eval(), Embedding(model.get_input_embeddings()).eval(),
        Decoder(text, model.lm_head).eval(), prepare, text.config, family.threefold,
    )  # fmt: skip
    return model, networks


def _image_processor(folder: Path, family: Family) -> Any:
    """What prepares its images, by Pillow: the other needs torchvision."""
    import transformers

    kind = getattr(transformers, f"{family.prefix}ImageProcessorPil")
    try:
        return kind.from_pretrained(folder, local_files_only=True)
    except Exception as error:  # transformers raises many types
        raise ExportError(f"{folder}: its image processor: {one_line(error)}") from None


def export(args: Any) -> dict[str, LetterReport]:
    """Make every file and card that was asked for; the parity by card.

    Args:
        args: as `exporters.clip.export`.

    Raises:
        ExportError: the folder or the pictures cannot be used, or a parity misses its limits.
    """
    folder: Path = args.weights
    if unknown := [p for p in args.precision if p not in PRECISIONS]:
        choices = ", ".join(PRECISIONS)
        raise ExportError(f"--precision: {unknown[0]!r} (choices: {choices})")
    if set(args.precision) != {"fp32"}:
        need_pictures(args.calibration, args.card)
    calibration, validation = pictures(args.calibration, args.validation)
    model, networks = load_model(folder)
    asked = questions(folder, model.config.image_token_id)
    for question in asked:
        used = (*question.ids(1)[0].tolist(), *question.letters)
        hugging_face.check_tokens(folder, used, networks.text.vocab_size)
    original = Original(model, networks.prepare)
    shown = [original.show(read_rgb(path)) for path in validation] or [original.show(_noise())]
    reference = letter_logits(original, shown, asked)
    (args.cache / args.card / "onnx").mkdir(parents=True, exist_ok=True)
    digest = hugging_face.weights_sha256(folder)
    calibrated = digest_of(calibration) if calibration else None
    others = _copy_others(folder, args.cache / args.card, digest)
    reports = {}
    with traced(networks) as traces:
        maker = _Maker(traces, original, asked[0], calibration, args.cache / args.card / "onnx")
        for precision in args.precision:
            name = f"{args.card}-{precision}"
            files = [maker.make(*part) for part in zip(FILES, PRECISIONS[precision], strict=True)]
            chain = Chain([network for network, *_ in files])
            report = reports[name] = measure(reference, chain, shown, asked, original.merge)
            print(f"{name} against torch:\n{report.table()}", file=sys.stderr)
            if not args.no_gate:
                check_tolerance(report, TOLERANCES[precision], name)
            for path in itertools.chain(*files):
                write_sidecar(path, name, report.figures(), digest, calibrated)
            card = make_card(args, precision, files, others, report)
            card["image_tokens"] = max(len(picture.features) for picture in shown)
            text = yaml.safe_dump(card, sort_keys=False, width=110)
            write_atomically(args.cache / f"{name}.yaml", text.encode())
    return reports


def _noise() -> np.ndarray:
    """What FP32 is compared on where no pictures were given, (480, 640, 3) uint8."""
    return np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)


def _copy_others(folder: Path, out: Path, digest: str) -> list[str]:
    """Copy what says how to feed the networks, and say what it hashes to."""
    found = [name for name in OTHERS if (folder / name).is_file()]
    for name in found:
        write_atomically(out / name, read_regular(folder / name))
        write_sidecar(out / name, name, None, digest)
    return found


def make_card(
    args: Any, precision: str, paths: list[list[Path]], others: list[str], report: LetterReport
) -> dict[str, Any]:
    """A card of task `choice`."""
    parts = {
        key: {"file": f"onnx/{files[0].name}"}
        for key, files in zip(("vision_encoder", "embed_tokens", "decoder"), paths, strict=True)
    }
    beside = [f"onnx/{path.name}" for files in paths for path in files[1:]]
    return {
        "name": f"{args.card}-{precision}", "task": "choice", "family": args.family or args.card,
        "license": args.license or hugging_face.license_of(args.weights),
        "precision": precision, "folder": args.card, **parts,
        "others": [{"file": file} for file in (*others, *beside)],
        "measured": {"against torch": report.figures()},
    }  # fmt: skip


@contextmanager
def traced(networks: Networks) -> Iterator[dict[str, Path]]:
    """FP32 of the three, by name, for as long as the block goes on; each in a folder of its own."""
    layers = networks.text.num_hidden_layers
    heads, size = cache_shape(networks.text)
    n, before = TRACED_TOKENS, TRACED_PAST
    pasts = [f"{i}.{kind}" for i in range(layers) for kind in ("key", "value")]
    places = torch.arange(before, before + n)[None]
    rank = {0: "batch", 1: "tokens"}
    decoder = {
        "inputs_embeds": torch.zeros(1, n, networks.text.hidden_size),
        "attention_mask": torch.ones(1, before + n, dtype=torch.int64),
        "position_ids": places[None].expand(3, 1, n) if networks.threefold else places,
        **{CACHED[0] + name: torch.zeros(1, heads, before, size) for name in pasts},
    }
    decoder_axes = {
        "inputs_embeds": rank,
        "attention_mask": {0: "batch", 1: "all_tokens"},
        "position_ids": {1: "batch", 2: "tokens"} if networks.threefold else rank,
        "logits": {0: "batch"},
        **{CACHED[0] + name: {0: "batch", 2: "past_tokens"} for name in pasts},
        **{CACHED[1] + name: {0: "batch", 2: "all_tokens"} for name in pasts},
    }
    image = {key: torch.from_numpy(value) for key, value in networks.prepare(_noise()).items()}
    vision_axes = {
        **{key: {0: "batch", 1: "images"} for key in image}, "image_features": {0: "all_images"},
    }  # fmt: skip
    if networks.threefold:
        vision_axes = {"pixel_values": {0: "patches"}, "image_features": {0: "rows"}}
    tokens = {"input_ids": torch.zeros(1, n, dtype=torch.int64)}
    presents = tuple(CACHED[1] + name for name in pasts)
    wanted = {
        VISION: (networks.vision, image, ("image_features",), vision_axes),
        EMBEDDING: (
            networks.embedding, tokens, ("inputs_embeds",),
            {"input_ids": rank, "inputs_embeds": rank},
        ),
        DECODER: (networks.decoder, decoder, ("logits", *presents), decoder_axes),
    }  # fmt: skip
    with TemporaryDirectory(prefix="edge-export-") as temporary:
        paths = {}
        for name, (module, inputs, outputs, free) in wanted.items():
            print(f"{name}: tracing", file=sys.stderr)
            paths[name] = Path(temporary) / name / f"{name}.onnx"
            paths[name].parent.mkdir()
            with torch.inference_mode():
                trace_module(module, paths[name], inputs, outputs, free)
        yield paths


class _Maker:
    """Makes files of the traces, each once: several precisions of a model share some."""

    def __init__(
        self,
        traces: dict[str, Path],
        original: Original,
        asked: Question,
        calibration: list[Path],
        folder: Path,
    ) -> None:
        self._traces, self._folder = traces, folder
        self._made: dict[tuple[str, str], list[Path]] = {}
        few = [original.show(read_rgb(path)) for path in calibration[:HALF_PICTURES]]
        self._feeds = {
            VISION: [original.prepare(read_rgb(path)) for path in calibration],
            EMBEDDING: [{"input_ids": asked.ids(1)}],
            DECODER: [original.decoder_feeds(asked, shown) for shown in few],
        }

    def make(self, name: str, precision: str) -> list[Path]:
        """The file of a network in a precision, and those that it keeps weights in."""
        if (name, precision) not in self._made:
            suffix = "" if precision == "fp32" else f"_{precision}"
            out = self._folder / f"{name}{suffix}.onnx"
            print(f"{out.name}: making it", file=sys.stderr)
            self._made[name, precision] = self._make(name, precision, out)
        return self._made[name, precision]

    def _make(self, name: str, precision: str, out: Path) -> list[Path]:
        trace, feeds = self._traces[name], self._feeds[name]
        whole = sum(path.stat().st_size for path in trace.parent.iterdir()) < ONE_FILE_BYTES
        if name == VISION and precision == "int8" and whole:
            with replace_atomically(out) as temporary:
                quantize(trace, temporary, feeds, TRANSFORMER, "int8-cpu")
                check_format(temporary)
            return [out]
        model = onnx.load(trace)
        if precision in ("fp16", "q4f16"):
            model = to_fp16(model, _kept(model, feeds if whole else [], name), half_ends=CACHED)
            if precision == "q4f16":
                model = quantize_weights(model, "q4")
        elif precision != "fp32":
            model = quantize_weights(model, precision)
        return save_network(model, out)


def _kept(model: onnx.ModelProto, feeds: list[dict[str, np.ndarray]], name: str) -> set[str]:
    """Nodes that stay in float32; by their values only where there are feeds to see them on."""
    recipe = RECIPES[name]
    return kept_nodes(model, feeds, recipe) if feeds else set(nodes_like(model, recipe.not_fp16))


def save_network(model: onnx.ModelProto, out: Path) -> list[Path]:
    """Write a model, its weights in `FILE.onnx_data` beside it where one file does not hold them.

    Returns:
        The files: the model first.
    """
    size = sum(len(tensor.raw_data) for tensor in model.graph.initializer)
    if size < ONE_FILE_BYTES:
        with replace_atomically(out) as temporary:
            onnx.save(model, temporary)
            check_format(temporary)
        return [out]
    data = out.with_name(f"{out.name}_data")
    data.unlink(missing_ok=True)  # onnx would append to it
    onnx.save(
        model, out, save_as_external_data=True, all_tensors_to_one_file=True, location=data.name
    )
    return [out, data]
