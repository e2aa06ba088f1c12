"""Experiment arms: named changes of a configuration that an evaluation compares."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from edge.config import Config, load, parse
from edge.config.yaml_text import parse_yaml, read_yaml
from edge.errors import ConfigError
from edge.text import one_line

Data = dict[str, Any]
"""A configuration, or a part of one, as read from YAML."""
LOCKSTEP: Data = {
    "loop": {"lockstep": True},
    "sim": {"lockstep": True},
    "perception": {"isolation": "thread"},
}
"""Settings with which a result does not depend on real time."""


@dataclass(frozen=True, slots=True)
class ExperimentArm:
    """An experiment arm: one configuration to run episodes with.

    Attributes:
        base: the configuration that `settings` change.
        id: hash of the entire configuration; any change gives another id.
        path: source of `base`, for messages.
        forgets: True: the service forgets map and objects before each goal of a session.
    """

    name: str
    base: Data
    settings: Data
    id: str
    path: str
    forgets: bool = False


def with_and_without_memory(arms: Sequence[ExperimentArm]) -> list[ExperimentArm]:
    """Return each arm after its twin that forgets; the first is the baseline of a comparison."""
    twins = [
        replace(arm, name=f"{arm.name}, no memory", id=f"{arm.id}-forgets", forgets=True)
        for arm in arms
    ]
    return [arm for pair in zip(twins, arms, strict=True) for arm in pair]


# Set by the episode, or different in each run.
_NOT_HASHED = {"path": True, "zenoh": True, "sim": {"world", "start", "lockstep"}}


def make_arms(config: Config, settings_by_name: Mapping[str, Data]) -> list[ExperimentArm]:
    """Check and build the arms of these settings, by name; without any, `config` is the only arm.

    The key `config` in an arm's settings names another configuration to change.
    """
    by_name = settings_by_name or {config.policy.kind: {}}
    return [_make_arm(name, config, dict(settings)) for name, settings in by_name.items()]


def _make_arm(name: str, config: Config, settings: Data) -> ExperimentArm:
    base_path = settings.pop("config", None)
    base = config if base_path is None else load(str(base_path))
    data, path = data_of(base), base.path
    changed = parse(merged(data, settings), f"{path}: arm {name}")
    content = changed.model_dump(mode="json", exclude=_NOT_HASHED)
    for key in ("target", "instruction", "checkpoint"):
        del content["mission"][key]
    return ExperimentArm(name, data, settings, digest_of(content), path)


def digest_of(settings: Data) -> str:
    """Return a hash of settings: outcomes of other settings must not be used again."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:12]


def data_of(config: Config) -> Data:
    """Return all values of a configuration, with defaults, so that an arm can change any part."""
    return config.model_dump(mode="json", exclude={"path"})


def merged(*parts: Mapping[str, Any]) -> Data:
    """Merge sections, the last on top. A section with another `kind` replaces the one below.

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
                is_other_kind = value.get("kind", below.get("kind")) != below.get("kind")
                result[key] = merged({} if is_other_kind else below, value)
            else:
                result[key] = value
    return result


# -- from files and options -----------------------------------------------------------------------


def read_arms(path: Path) -> dict[str, Data]:
    """Read arms from a YAML file: a section of settings for each name.

    Raises:
        ConfigError: the file cannot be read or has another form.
    """
    data = read_yaml(path)
    if not isinstance(data, dict) or not data:
        raise ConfigError(
            f"{path}: expected one section of settings for each arm, such as "
            "`near: {policy: {kind: nearest_frontier}}`"
        )
    for name, settings in data.items():
        if not isinstance(settings, dict | None):
            raise ConfigError(
                f"{path}: {one_line(name)}: expected a section of settings, got "
                f"{one_line(settings):.80}"
            )
    return {str(name): settings or {} for name, settings in data.items()}


def parse_arm(words: Sequence[str]) -> tuple[str, Data]:
    """Parse an arm written as `NAME KEY=VALUE …`: keys with dots, values in YAML.

    >>> parse_arm(["search", "policy.kind=search", "perception.detector={kind: sim}"])
    ('search', {'policy': {'kind': 'search'}, 'perception': {'detector': {'kind': 'sim'}}})

    Raises:
        ConfigError: a setting has another form.
    """
    name, *settings = words
    data: Data = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        sections = key.split(".")
        if not equals or not all(sections):
            raise ConfigError(
                f"--arm {one_line(name)}: {one_line(setting)!r:.80}: expected KEY=VALUE, such "
                "as policy.kind=nearest_frontier"
            )
        try:
            part: Any = parse_yaml(value)
        except ValueError as error:
            raise ConfigError(f"--arm {one_line(name)}: {key}: {error}") from None
        for section in reversed(sections):
            part = {section: part}
        data = merged(data, part)
    return name, data
