"""Reader of Hugging Face model folders: configuration, weights, tokenizer, licence.

Only safetensors are read, because a .bin is a pickle, which can run code. Nothing is downloaded.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

# Before the imports that read them: nothing may be downloaded or sent.
os.environ.setdefault("HF_HUB_OFFLINE", "1")
os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")

from edge.config.yaml_text import parse_yaml
from edge.host.files import read_regular
from edge.text import one_line, read_json_object
from exporters.files import ExportError, sha256_of

if TYPE_CHECKING:
    from torch import nn

CONFIG, TOKENIZER = "config.json", "tokenizer.json"  # files of a folder
LICENSE_UNKNOWN = "unknown"


def read_json(path: Path) -> dict[str, Any]:
    """Return a JSON object of a model's folder; raise ExportError if it is missing or invalid."""
    try:
        return read_json_object(read_regular(path))
    except (OSError, ValueError) as error:
        raise ExportError(
            f"{path}: cannot be read: {one_line(error)}; give the entire folder of a model, as "
            "Hugging Face publishes it"
        ) from None


def model_type(folder: Path) -> str:
    """Return the architecture that a folder's `config.json` names."""
    found = read_json(folder / CONFIG).get("model_type")
    if not isinstance(found, str):
        raise ExportError(
            f"{folder / CONFIG}: model_type is missing; give a model folder of Hugging Face "
            "transformers"
        )
    return found


def weight_files(folder: Path) -> list[Path]:
    """Return the folder's safetensors, in name order; raise ExportError if there are none."""
    found = sorted(folder.glob("*.safetensors"))
    if not found:
        raise ExportError(
            f"{folder}: no *.safetensors; fetch the model's safetensors (a .bin file is not "
            "opened, because loading one can run code)"
        )
    return found


def weights_sha256(folder: Path) -> str:
    """Return one digest of all weight files: the digest of their digests, in name order."""
    digests = "".join(sha256_of(path) for path in weight_files(folder))
    return hashlib.sha256(digests.encode()).hexdigest()


def load(kind: type, folder: Path) -> nn.Module:
    """Return the model with all its weights: float32, evaluation mode, eager attention.

    Raises:
        ExportError: the model cannot be loaded, or weights are missing, which would stay random.
    """
    weight_files(folder)
    import torch
    from transformers.utils import logging

    logging.disable_progress_bar()
    try:
        model, found = kind.from_pretrained(
            folder, local_files_only=True, use_safetensors=True, trust_remote_code=False,
            dtype=torch.float32, attn_implementation="eager", output_loading_info=True,
        )  # fmt: skip
    except Exception as error:  # transformers raises many types
        raise ExportError(
            f"{folder}: transformers cannot load the model: {one_line(error)}"
        ) from None
    if missing := sorted(found["missing_keys"]):
        raise ExportError(
            f"{folder}: {len(missing)} weights are missing ({missing[0]}, …); fetch the folder "
            "again"
        )
    return model.eval().requires_grad_(False)


def license_of(folder: Path) -> str:
    """Return the licence in the front matter of `README.md`; `unknown` without one."""
    try:
        text = read_regular(folder / "README.md").decode("utf-8")
        _, front, _ = text.split("---", 2)
        found = parse_yaml(front).get("license")
    except (OSError, ValueError, AttributeError):
        return LICENSE_UNKNOWN
    return found if isinstance(found, str) and found else LICENSE_UNKNOWN


def tokenizer_text(folder: Path, lowercase: bool = False) -> str:
    """Return the content of the folder's `tokenizer.json`.

    Some models were trained on lower case, but leave this to code of `transformers`: `lowercase`
    adds it to the file.
    """
    path = folder / TOKENIZER
    tokenizer = open_tokenizer(path)
    if lowercase and tokenizer.encode("CHAIR").ids != tokenizer.encode("chair").ids:
        from tokenizers import normalizers

        before = [] if tokenizer.normalizer is None else [tokenizer.normalizer]
        tokenizer.normalizer = normalizers.Sequence([normalizers.Lowercase(), *before])
        return tokenizer.to_str()
    return read_regular(path).decode("utf-8")


def open_tokenizer(path: Path) -> Any:
    """Return a `tokenizers.Tokenizer`; raise ExportError if there is none."""
    from tokenizers import Tokenizer

    if not path.is_file():
        raise ExportError(
            f"{path}: no such file; write the file with save_pretrained() of transformers' "
            "AutoTokenizer"
        )
    try:
        return Tokenizer.from_file(str(path))
    except Exception as error:  # it raises Exception itself
        raise ExportError(
            f"{path}: not a tokenizer file: {one_line(error)}; fetch the folder again"
        ) from None


def check_tokens(folder: Path, tokens: Iterable[int], size: int) -> None:
    """Raise ExportError if a token is beyond the model's vocabulary of `size`."""
    if (largest := max(tokens, default=0)) >= size:
        raise ExportError(
            f"{folder / TOKENIZER}: has a token {largest}, but the model only tokens 0 to "
            f"{size - 1}, so the files are of two models; fetch the folder again"
        )


def pad_token(folder: Path) -> int:
    """Return the id of the padding token; raise ExportError if none is named."""
    path = folder / "tokenizer_config.json"
    named = read_json(path).get("pad_token")
    named = named.get("content") if isinstance(named, dict) else named
    found = None
    if isinstance(named, str):
        found = open_tokenizer(folder / TOKENIZER).token_to_id(named)
    if found is None:
        raise ExportError(
            f"{path}: pad_token {json.dumps(named)} is not in {TOKENIZER}; fetch the folder again"
        )
    return found
