"""Files of a published language model next to its networks: configuration, tokenizer, template.

`read_files` reads them all, as `ModelFiles`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from edge.host.files import read_regular
from edge.perception.runtime.card_types import ChoiceCard
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.tokenizer import read_tokenizer
from edge.text import one_line, read_json_object

CONFIG = "config.json"
TOKENIZER = "tokenizer.json"
TOKENIZER_CONFIG = "tokenizer_config.json"
PREPROCESSOR = "preprocessor_config.json"
PROCESSOR = "processor_config.json"
TEMPLATES = ("chat_template.jinja", "chat_template.json")
"""Files that may hold the chat template, if it is not in the tokenizer's configuration."""
EXTRA = "pip install 'edge-vln[choice]'"
"""Command that installs the packages of these models, for messages."""


@dataclass(frozen=True)
class ModelFiles:
    """The content of a model's folder.

    Attributes:
        config: content of `config.json`, the configuration of the network.
        image: settings for the preparation of images; None for a model that takes no images.
        processor: settings for the combination of texts and images; often empty.
        special: texts of the special tokens that a template may name: `bos_token`, `eos_token` …
        template: the chat template's source, in Jinja.
    """

    name: str
    folder: Path
    config: dict[str, Any]
    image: dict[str, Any] | None
    processor: dict[str, Any]
    special: dict[str, str]
    template: str

    @property
    def text_config(self) -> dict[str, Any]:
        """Configuration of the language model within the network."""
        inner = self.config.get("text_config")
        return inner if isinstance(inner, dict) else self.config


def read_files(card: ChoiceCard) -> ModelFiles:
    """Read the folder of a card's model.

    Raises:
        ModelError: a file is missing or invalid.
    """
    folder = card.path
    tokenizer = _read(card, TOKENIZER_CONFIG)
    processor = _read(card, PROCESSOR, needed=False)
    image = _read(card, PREPROCESSOR, needed=False) or processor.get("image_processor")
    if card.vision_encoder is not None and not isinstance(image, dict):
        raise ModelError(
            f"{folder / PREPROCESSOR}: model {card.name}: its card does not name this file, which "
            "configures the image preprocessing; add it under `others` in the card"
        )
    return ModelFiles(
        name=card.name,
        folder=folder,
        config=_read(card, CONFIG),
        image=image if card.vision_encoder is not None else None,
        processor=processor,
        special=_special(tokenizer),
        template=_template(card, tokenizer),
    )


def _read(card: ChoiceCard, name: str, needed: bool = True) -> dict[str, Any]:
    """Read a JSON file of the model; {} if the card does not name it and it is not needed."""
    path = card.path / name
    if not any(part.file == name for part in card.others):
        if needed:
            raise ModelError(
                f"model {card.name}: needs {name}, but its card does not name it; add {name} under "
                "`others` in the card"
            )
        return {}
    try:
        return read_json_object(read_regular(path))
    except (OSError, ValueError) as error:
        raise ModelError(f"{path}: model {card.name}: cannot be read: {one_line(error)}") from None


def _special(tokenizer: dict[str, Any]) -> dict[str, str]:
    """Return the special tokens; each is a text, or an object with one."""
    found = {}
    for key, value in tokenizer.items():
        text = value.get("content") if isinstance(value, dict) else value
        if key.endswith("_token") and isinstance(text, str):
            found[key] = text
    return found


def _template(card: ChoiceCard, tokenizer: dict[str, Any]) -> str:
    """Return the chat template: from its own file, else from the tokenizer's configuration."""
    listed = {part.file for part in card.others}
    for name in TEMPLATES:
        if name not in listed:
            continue
        path = card.path / name
        try:
            text = read_regular(path).decode()
            return text if name.endswith(".jinja") else _text_of(json.loads(text)["chat_template"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            why = one_line(error)
            raise ModelError(f"{path}: model {card.name}: no chat template: {why}") from None
    try:
        return _text_of(tokenizer["chat_template"])
    except (KeyError, TypeError, StopIteration):
        raise ModelError(
            f"model {card.name}: no chat template: neither in {TOKENIZER_CONFIG}, nor in a file "
            f"({', '.join(TEMPLATES)}) that the card names; add such a file to the model's folder, "
            "and under `others` in the card"
        ) from None


def _text_of(template: Any) -> str:
    """Return the text of a template.

    The template is a text, or a list of templates with names, of which `default` counts.
    """
    if isinstance(template, str):
        return template
    return str(next(item["template"] for item in template if item["name"] == "default"))


def open_tokenizer(files: ModelFiles) -> Any:
    """Open the tokenizer of a model, without padding or truncation.

    Raises:
        ModelError: the package is not installed, or the file is no tokenizer.
    """
    return read_tokenizer(files.folder / TOKENIZER, f"model {files.name}", EXTRA)


def vocabulary(tokenizer: Any) -> Sequence[str]:
    """Return the text of each token, by id; "" for a token without a text."""
    size = tokenizer.get_vocab_size(with_added_tokens=True)
    return tokenizer.decode_batch([[i] for i in range(size)], skip_special_tokens=False)


def common_prefix(a: np.ndarray, b: np.ndarray) -> int:
    """Return the length of the common prefix of two rows.

    >>> common_prefix(np.array([3, 1, 2]), np.array([3, 1, 4, 5]))
    2
    """
    n = min(len(a), len(b))
    differ = np.flatnonzero(a[:n] != b[:n])
    return int(differ[0]) if len(differ) else n
