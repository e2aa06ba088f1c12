"""YAML that anybody may have written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from edge.errors import ConfigError
from edge.host.files import read_regular
from edge.text import one_line


def read_yaml(path: Path) -> Any:
    """What a YAML file says.

    Raises:
        ConfigError: it cannot be read, or is not YAML; one line.
    """
    try:
        return parse_yaml(read_regular(path))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: not YAML: {error}") from None


def parse_yaml(text: str | bytes) -> Any:
    """What a YAML text says, without tags of Python's.

    Raises:
        ValueError: it is not YAML, not UTF-8, or has a value that is not of its type (2024-13-45);
            the message is one line.
    """
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(one_line(error, 400)) from None
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except (AttributeError, IndexError, KeyError):  # PyYAML's at `!!timestamp x`, `!!int ""`
        raise ValueError("a value is not what its tag says") from None
