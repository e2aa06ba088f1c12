"""Reader of a published model's tokenizer: a `tokenizer.json` of Hugging Face."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from edge.perception.runtime.model_file import ModelError
from edge.text import one_line


def read_tokenizer(path: Path, model: str, install: str) -> Any:
    """Read a `tokenizers.Tokenizer`, without padding or truncation.

    Raises:
        ModelError: the package is not installed, or the file is no tokenizer.
    """
    try:
        from tokenizers import Tokenizer
    except ImportError:
        raise ModelError(f"{model}: the package tokenizers is not installed: {install}") from None
    try:
        tokenizer = Tokenizer.from_file(str(path))
    except Exception as error:  # the package raises plain Exception
        raise ModelError(f"{path}: not a tokenizer: {one_line(error)}") from None
    tokenizer.no_padding()
    tokenizer.no_truncation()
    return tokenizer
