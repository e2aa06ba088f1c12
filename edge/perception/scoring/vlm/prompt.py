"""Turns rules, a view and a question into tokens, with the model's own chat template."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from edge.perception.runtime.model_file import ModelError
from edge.perception.scoring.vlm.files import EXTRA, TEMPLATES, ModelFiles, open_tokenizer
from edge.text import one_line

Messages = list[dict[str, Any]]


class Prompter:
    """Builds the text that a language model reads, and encodes it as token ids.

    Attributes:
        image_id: id of the token that image features replace; -1 if the model takes no images.
        image_token: text of that token; "" if the model takes no images.

    Raises:
        ModelError: a package or file is missing or unusable.
    """

    def __init__(self, files: ModelFiles) -> None:
        self._name = files.name
        self.tokenizer = open_tokenizer(files)
        self.image_id, self.image_token = -1, ""
        if files.image is not None:
            self.image_id, self.image_token = find_image_token(files, self.tokenizer)
        self._render = _compile(files)

    def text(self, rules: str, view: str | None, question: str) -> str:
        """Return the text that the model reads; an image is one token.

        Args:
            rules: the system message.
            view: the view in words; None: an image is shown.
            question: the question.

        Raises:
            ModelError: the template fails, or leaves a part out.
        """
        if self.image_id >= 0:
            system: Any = [{"type": "text", "text": rules}]
            seen = {"type": "image"} if view is None else {"type": "text", "text": view}
            user: Any = [seen, {"type": "text", "text": question}]
        else:  # without a view, the check of the number of images below fails
            system, user = rules, f"{view}\n{question}"
        messages = [{"role": "system", "content": system}, {"role": "user", "content": user}]
        text = self._render(messages)
        missing = [part for part in (rules, view, question) if part and part not in text]
        if missing:
            raise ModelError(
                f"model {self._name}: its chat template ({', '.join(TEMPLATES)}) leaves out "
                f"{one_line(missing[0], 40)!r}: the template is of another model, or damaged"
            )
        images = text.count(self.image_token) if self.image_token else 0
        expected = 1 if view is None else 0
        if images != expected:
            raise ModelError(
                f"model {self._name}: its chat template shows {images} images "
                f"({self.image_token or 'the model takes none'}), expected {expected}: "
                "the template is of another model, or damaged"
            )
        return text

    def ids(self, text: str) -> np.ndarray:
        """Return token ids, (n,) int64; the template already has all special tokens."""
        return np.array(self.tokenizer.encode(text, add_special_tokens=False).ids, np.int64)


def find_image_token(files: ModelFiles, tokenizer: Any) -> tuple[int, str]:
    """Return id and text of the image token; raise ModelError if the tokenizer does not have it."""
    found = files.config.get("image_token_id", files.config.get("image_token_index"))
    token = tokenizer.id_to_token(found) if isinstance(found, int) and found >= 0 else None
    if token is None:
        raise ModelError(
            f"{files.folder}: model {files.name}: config.json's image_token_id is {found!r}, "
            "which the tokenizer does not have: the files are of two models"
        )
    return found, token


def _compile(files: ModelFiles) -> Callable[[Messages], str]:
    """Compile the chat template in jinja's sandbox, since it comes with the model's weights.

    The environment is that of transformers (`chat_template_utils`).
    """
    try:
        from jinja2 import TemplateError
        from jinja2.sandbox import ImmutableSandboxedEnvironment
    except ImportError:
        raise ModelError(
            f"model {files.name}: the package jinja2 is not installed: {EXTRA}"
        ) from None

    def refuse(why: str) -> None:
        raise TemplateError(why)

    environment = ImmutableSandboxedEnvironment(
        trim_blocks=True, lstrip_blocks=True, extensions=["jinja2.ext.loopcontrols"]
    )
    environment.filters["tojson"] = lambda data, **how: json.dumps(
        data, ensure_ascii=False, indent=how.get("indent")
    )
    environment.globals["raise_exception"] = refuse

    def failed(error: Exception) -> ModelError:
        where = f", line {line}" if (line := getattr(error, "lineno", None)) else ""
        return ModelError(
            f"model {files.name}: its chat template{where}: {type(error).__name__}: "
            f"{one_line(error, 200)}"
        )

    try:
        template = environment.from_string(files.template)
    except Exception as error:
        raise failed(error) from None

    def render(messages: Messages) -> str:
        try:
            return template.render(
                messages=messages, add_generation_prompt=True, tools=None, **files.special
            )
        except Exception as error:  # a template may raise anything
            raise failed(error) from None

    return render
