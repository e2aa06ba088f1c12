"""Export of vision-language models from a Hugging Face folder to three ONNX files.

    edge models export NAME --weights FOLDER

writes `NAME/onnx/vision_encoder.onnx`, `embed_tokens.onnx` and `decoder_model_merged.onnx` in FP32,
the files that describe preprocessing, and a card. The layout is that of published models.
`exporters.vlm_quantize` makes variants. Keys and values of earlier tokens are inputs and outputs of
the decoder, so one file reads a prompt and continues it.
"""

from __future__ import annotations

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
from torch import nn

from edge.host.files import read_regular, write_atomically
from edge.perception.scoring.vlm.decoder import DEEPSTACK
from edge.text import one_line
from exporters import hugging_face
from exporters.files import ExportError, write_card
from exporters.images import read_rgb
from exporters.onnx_format import trace_module
from exporters.quantize import pictures
from exporters.sidecar import write_sidecar
from exporters.vlm_files import (
    DECODER,
    EMBEDDING,
    VISION,
    compare_and_place,
    files_of_card,
    new_files,
    save_network,
)
from exporters.vlm_networks import (
    Decoder,
    Embedding,
    Idefics3Vision,
    Qwen2Vision,
    Qwen3Vision,
)
from exporters.vlm_parity import EncodedImage, LetterComparison, LetterReport, Question, questions

OTHER_FILES = (
    "config.json", "tokenizer.json", "tokenizer_config.json", "preprocessor_config.json",
    "processor_config.json", "chat_template.jinja", "chat_template.json",
)  # fmt: skip
"""Files that describe the preprocessing, if the folder has them."""
TRACED_TOKENS, TRACED_PAST = 3, 2
"""Numbers of new tokens and of tokens so far in the example from which the decoder is traced."""


class Networks(NamedTuple):
    """The three networks of a model, and its image preprocessing.

    Attributes:
        prepare: (h, w, 3) uint8 → inputs of the vision encoder, by name.
        threefold: True if position ids have three numbers (M-RoPE).
        deepstack: number of the decoder's layers that get features of the image, too.
    """

    vision: nn.Module
    embedding: nn.Module
    decoder: nn.Module
    prepare: Callable[[np.ndarray], dict[str, np.ndarray]]
    text: Any
    threefold: bool
    deepstack: int


@dataclass(frozen=True)
class Family:
    """One architecture.

    Attributes:
        prefix: prefix of the names of its classes in `transformers`.
        text: attribute of the model that holds its language model.
        threefold: True if position ids have three numbers (M-RoPE).
        processor: prefix of the name of its image processor, if it has another.
    """

    prefix: str
    vision: type[nn.Module]
    text: str
    threefold: bool = False
    processor: str = ""


FAMILIES = {
    "idefics3": Family("Idefics3", Idefics3Vision, "text_model"),
    "smolvlm": Family("SmolVLM", Idefics3Vision, "text_model"),
    "qwen2_vl": Family("Qwen2VL", Qwen2Vision, "language_model", threefold=True),
    "qwen3_vl": Family("Qwen3VL", Qwen3Vision, "language_model", True, processor="Qwen2VL"),
}
"""Architectures by `model_type`; SmolVLM 2 has `smolvlm`, SmolVLM has `idefics3`."""


class TorchReference:
    """The original model, run by `transformers` as one model; see `vlm_parity.ReferenceModel`.

    Attributes:
        prepare: (h, w, 3) uint8 → inputs of the vision encoder's ONNX.
    """

    def __init__(self, model: nn.Module, prepare: Callable[[np.ndarray], dict]) -> None:
        self._model, self.prepare = model, prepare

    def show(self, rgb: np.ndarray) -> EncodedImage:
        """Preprocess and encode an image, (h, w, 3) uint8."""
        feeds = self.prepare(rgb)
        with torch.inference_mode():
            output = self._model.model.get_image_features(**_inputs(feeds))
        parts = [output.pooler_output, *(getattr(output, "deepstack_features", None) or ())]
        # Releases of transformers differ: rows of all images, or a tuple with those of each.
        parts = [part if torch.is_tensor(part) else torch.cat(tuple(part)) for part in parts]
        features = torch.cat([one.reshape(-1, one.shape[-1]) for one in parts], dim=-1)
        grid = None
        if "grid_thw" in feeds:
            # Side, in patches, of the square of the image that one token stands for.
            merge = self._model.model.visual.spatial_merge_size
            frames, rows, columns = feeds["grid_thw"][0].tolist()
            grid = frames, rows // merge, columns // merge
        return EncodedImage(feeds, features.numpy(), grid)

    def logits(self, question: Question, shown: EncodedImage) -> np.ndarray:
        """Return logits (v,) float32 of the token after the question; v tokens exist."""
        ids = torch.from_numpy(question.ids(len(shown.features)))[None]
        more = {}  # Qwen2-VL must know which tokens are the image
        if shown.grid is not None:
            more["mm_token_type_ids"] = (ids == question.image).to(torch.int32)
        with torch.inference_mode():
            found = self._model(
                input_ids=ids, attention_mask=torch.ones_like(ids), **_inputs(shown.feeds), **more
            )
        return found.logits[0, -1].numpy()


def _inputs(feeds: dict[str, np.ndarray]) -> dict[str, Any]:
    """Rename inputs of the vision encoder's ONNX to those of transformers."""
    renamed = {"grid_thw": "image_grid_thw"}
    return {renamed.get(key, key): torch.from_numpy(value) for key, value in feeds.items()}


def load_model(folder: Path) -> tuple[nn.Module, Networks]:
    """Return the model of a folder and its networks.

    Raises:
        ExportError: the folder cannot be used, or the model cannot be traced.
    """
    import transformers

    family = FAMILIES[hugging_face.model_type(folder)]
    model = hugging_face.load(
        getattr(transformers, f"{family.prefix}ForConditionalGeneration"), folder
    )
    text = getattr(model.model, family.text)
    rope = text.rotary_emb.rope_type
    if rope in ("dynamic", "longrope"):
        raise ExportError(
            f"{folder}: config.json: rope_type {rope!r} is not supported; give another model"
        )
    if getattr(text.config, "use_sliding_window", False):
        raise ExportError(
            f"{folder}: config.json: use_sliding_window is not supported; set the field to false"
        )
    processor = _image_processor(folder, family)

    def prepare(rgb: np.ndarray) -> dict[str, np.ndarray]:
        """See `Networks.prepare`."""
        if family.threefold:
            found = processor(images=[rgb], return_tensors="np")
            return {"pixel_values": found["pixel_values"], "grid_thw": found["image_grid_thw"]}
        found = processor(images=[[rgb]], do_image_splitting=False, return_tensors="np")
        mask = found["pixel_attention_mask"].astype(bool)
        return {"pixel_values": found["pixel_values"], "pixel_attention_mask": mask}

    visual = getattr(model.model, "visual", None)
    deepstack = len(getattr(visual, "deepstack_merger_list", ()))
    networks = Networks(
        family.vision(model.model).eval(), Embedding(model.get_input_embeddings()).eval(),
        Decoder(text, model.lm_head, deepstack).eval(), prepare, text.config, family.threefold,
        deepstack,
    )  # fmt: skip
    return model, networks


def _image_processor(folder: Path, family: Family) -> Any:
    """Return the model's image processor, in its Pillow version; the other needs torchvision."""
    import transformers

    kind = getattr(transformers, f"{family.processor or family.prefix}ImageProcessorPil")
    try:
        return kind.from_pretrained(folder, local_files_only=True)
    except Exception as error:  # transformers raises many types
        raise ExportError(
            f"{folder}: transformers cannot load the image processor: {one_line(error)}"
        ) from None


def export(args: Any) -> dict[str, LetterReport]:
    """Make the FP32 files and their card; return the parity by card.

    Raises:
        ExportError: the folder or the images cannot be used, or the parity misses its limits.
    """
    name = f"{args.card}-fp32"
    if derived := [p for p in args.precision if p != "fp32"]:
        raise ExportError(
            f"--precision: got {derived[0]!r:.60}, but from a folder only fp32 can be made; then "
            "run "
            f"`edge models export {name} --quantize --precision P --calibration PICTURES`"
        )
    _, validation = pictures(args.calibration, args.validation)
    model, networks = load_model(args.weights)
    asked = questions(args.weights, model.config.image_token_id)
    for question in asked:
        used = [*question.ids(1).tolist(), *np.concatenate(question.letters).tolist()]
        hugging_face.check_tokens(args.weights, used, networks.text.vocab_size)
    original = TorchReference(model, networks.prepare)
    shown = [original.show(read_rgb(path)) for path in validation] or [original.show(_noise())]
    comparison = LetterComparison(original, shown, asked)
    folder = args.cache / args.card
    digest = hugging_face.weights_sha256(args.weights)
    with new_files(folder / "onnx") as new:
        with traced(networks) as traces:
            files = [save_network(onnx.load(path), new / path.name) for path in traces.values()]
        report, files = compare_and_place(
            files, folder / "onnx", "fp32", name, comparison, "torch", not args.no_gate,
            (digest, None),
        )  # fmt: skip
    others = _copy_others(args.weights, folder, digest)
    card = {
        "name": name, "task": "choice", "family": args.family or args.card,
        "license": args.license or hugging_face.license_of(args.weights),
        "precision": "fp32", "folder": args.card, **files_of_card(files, folder, others),
        "measured": {"against torch": report.figures()},
        "image_tokens": max(len(picture.features) for picture in shown),
    }  # fmt: skip
    write_card(card, args.cache)
    return {name: report}


def _noise() -> np.ndarray:
    """Return a noise image, (480, 640, 3) uint8, to compare FP32 on if there are no images."""
    return np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)


def _copy_others(folder: Path, out: Path, digest: str) -> list[str]:
    """Copy the files of `OTHER_FILES` and write their sidecars; return their names."""
    found = [name for name in OTHER_FILES if (folder / name).is_file()]
    for name in found:
        write_atomically(out / name, read_regular(folder / name))
        write_sidecar(out / name, name, None, digest)
    return found


@contextmanager
def traced(networks: Networks) -> Iterator[dict[str, Path]]:
    """Trace the three networks as FP32 ONNX, each in its own temporary folder.

    Yields:
        Path by name; the files exist until the block ends.
    """
    text = networks.text  # configuration of the language model
    layers, heads = text.num_hidden_layers, text.num_key_value_heads
    size = getattr(text, "head_dim", None) or text.hidden_size // text.num_attention_heads
    n, n_past = TRACED_TOKENS, TRACED_PAST
    cached_names = [f"{i}.{kind}" for i in range(layers) for kind in ("key", "value")]
    positions = torch.arange(n_past, n_past + n)[None]
    past_prefix, present_prefix = "past_key_values.", "present."
    batch_and_tokens = {0: "batch", 1: "tokens"}  # names of the dynamic axes
    deepstack = [f"{DEEPSTACK}{i}" for i in range(networks.deepstack)]
    embedded = torch.zeros(1, n, networks.text.hidden_size)
    decoder = {
        "inputs_embeds": embedded,
        "attention_mask": torch.ones(1, n_past + n, dtype=torch.int64),
        "position_ids": positions[None].expand(3, 1, n) if networks.threefold else positions,
        **dict.fromkeys(deepstack, embedded),
        **{past_prefix + name: torch.zeros(1, heads, n_past, size) for name in cached_names},
    }
    decoder_axes = {
        "inputs_embeds": batch_and_tokens,
        "attention_mask": {0: "batch", 1: "all_tokens"},
        "position_ids": {1: "batch", 2: "tokens"} if networks.threefold else batch_and_tokens,
        "logits": {0: "batch"},
        **dict.fromkeys(deepstack, batch_and_tokens),
        **{past_prefix + name: {0: "batch", 2: "past_tokens"} for name in cached_names},
        **{present_prefix + name: {0: "batch", 2: "all_tokens"} for name in cached_names},
    }
    image = {key: torch.from_numpy(value) for key, value in networks.prepare(_noise()).items()}
    vision_axes = {
        **{key: {0: "batch", 1: "images"} for key in image}, "image_features": {0: "all_images"},
    }  # fmt: skip
    if networks.threefold:
        rows = {key: {0: "rows"} for key in ("image_features", *deepstack)}
        vision_axes = {"pixel_values": {0: "patches"}, **rows}
    tokens = {"input_ids": torch.zeros(1, n, dtype=torch.int64)}
    presents = tuple(present_prefix + name for name in cached_names)
    # Network, example inputs, names of the outputs, dynamic axes.
    jobs = {
        VISION: (networks.vision, image, ("image_features", *deepstack), vision_axes),
        EMBEDDING: (
            networks.embedding, tokens, ("inputs_embeds",),
            {"input_ids": batch_and_tokens, "inputs_embeds": batch_and_tokens},
        ),
        DECODER: (networks.decoder, decoder, ("logits", *presents), decoder_axes),
    }  # fmt: skip
    with TemporaryDirectory(prefix="edge-export-") as temporary:
        paths = {}
        for name, (module, inputs, outputs, free) in jobs.items():
            print(f"{name}: tracing", file=sys.stderr)
            paths[name] = Path(temporary) / name / f"{name}.onnx"
            paths[name].parent.mkdir()
            with torch.inference_mode():
                trace_module(module, paths[name], inputs, outputs, free)
        yield paths
