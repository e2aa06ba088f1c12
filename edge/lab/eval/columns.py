"""Columns of an evaluation: a name, and what of the configuration is different in it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge.config import Config, load, parse
from edge.config.yaml_text import parse_yaml, read_yaml
from edge.errors import ConfigError
from edge.text import one_line

Data = dict[str, Any]
"""A configuration, or part of one, as YAML would have it."""


@dataclass(frozen=True, slots=True)
class Column:
    """A way to run episodes.

    Attributes:
        base: the configuration that `settings` change.
        id: a hash of the whole configuration: another one when anything in it changes.
        path: where the base came from, for messages.
    """

    name: str
    base: Data
    settings: Data
    id: str
    path: str


# What the episode says, and what differs from run to run.
_NOT_HASHED = {"path": True, "zenoh": True, "sim": {"world", "start", "lockstep"}}


def make_columns(config: Config, columns: Mapping[str, Data]) -> list[Column]:
    """Check and name the columns; with none, the configuration itself is the only one.

    Args:
        columns: by name, the settings that change `config`; a column's own `config` names another
            configuration to change.

    Raises:
        ConfigError: the settings of one do not make a configuration.
    """
    columns = columns or {config.policy.kind: {}}
    return [_column(name, config, dict(settings)) for name, settings in columns.items()]


def _column(name: str, config: Config, settings: Data) -> Column:
    other = settings.pop("config", None)
    base = config if other is None else load(str(other))
    data, path = data_of(base), base.path
    whole = parse(merged(data, settings), f"{path}: column {name}")
    content = whole.model_dump(mode="json", exclude=_NOT_HASHED)
    for key in ("target", "instruction", "checkpoint"):
        del content["mission"][key]
    code = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
    return Column(name, data, settings, code, path)


def data_of(config: Config) -> Data:
    """All of a configuration: so that a column can change a part of what is there by default."""
    return config.model_dump(mode="json", exclude={"path"})


def merged(*parts: Mapping[str, Any]) -> Data:
    """Sections laid over each other, the last on top; one of another `kind` replaces the one below.

    >>> merged({"policy": {"kind": "hvl", "w_vl": 2}}, {"policy": {"w_dist": 1}})
    {'policy': {'kind': 'hvl', 'w_vl': 2, 'w_dist': 1}}
    >>> merged({"policy": {"kind": "hvl", "w_vl": 2}}, {"policy": {"kind": "nearest_frontier"}})
    {'policy': {'kind': 'nearest_frontier'}}
    """
    result: Data = {}
    for part in parts:
        for key, value in part.items():
            below = result.get(key)
            if isinstance(value, Mapping):
                below = below if isinstance(below, dict) else {}
                other = value.get("kind", below.get("kind")) != below.get("kind")
                result[key] = merged({} if other else below, value)
            else:
                result[key] = value
    return result


# -- as they are given ----------------------------------------------------------------------------


def read_columns(path: Path) -> dict[str, Data]:
    """The columns of a YAML file: a section of settings for each name.

    Raises:
        ConfigError: it cannot be read, or is no such file.
    """
    data = read_yaml(path)
    if not isinstance(data, dict) or not data:
        raise ConfigError(f"{path}: expected a section of settings for each column's name")
    for name, settings in data.items():
        if not isinstance(settings, dict | None):
            raise ConfigError(f"{path}: {one_line(name)}: expected a section of settings")
    return {str(name): settings or {} for name, settings in data.items()}


def parse_column(words: Sequence[str]) -> tuple[str, Data]:
    """A column as `NAME KEY=VALUE …`, keys with dots, values in YAML.

    >>> parse_column(["search", "policy.kind=search", "perception.detector={kind: sim}"])
    ('search', {'policy': {'kind': 'search'}, 'perception': {'detector': {'kind': 'sim'}}})

    Raises:
        ConfigError: a setting is not of that form.
    """
    name, *settings = words
    data: Data = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        sections = key.split(".")
        if not equals or not all(sections):
            raise ConfigError(
                f"--column {one_line(name)}: {one_line(setting)!r:.80}: expected KEY=VALUE, such "
                "as policy.kind=nearest_frontier"
            )
        try:
            part: Any = parse_yaml(value)
        except ValueError as error:
            raise ConfigError(f"--column {one_line(name)}: {key}: {error}") from None
        for section in reversed(sections):
            part = {section: part}
        data = merged(data, part)
    return name, data
