"""Where things lie: ready configurations, model cards, and the cache."""

from __future__ import annotations

import os
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def data_dir(kind: str) -> Path:
    """The folder of `config` or `models`: inside an installed wheel, or in a clone."""
    packaged = _PACKAGE / "_data" / kind
    return packaged if packaged.is_dir() else _PACKAGE.parent / kind


def find_config(name_or_path: str) -> Path:
    """A configuration file by path, or a ready one by name or file name."""
    path = Path(name_or_path).expanduser()
    if path.exists():
        return path
    ready = data_dir("config") / f"{path.stem}.yaml"
    if ready.exists():
        return ready
    from edge.config import ConfigError

    names = ", ".join(sorted(p.stem for p in data_dir("config").glob("*.yaml")))
    raise ConfigError(f"{name_or_path}: no such file (ready configurations: {names})")


def cache_dir() -> Path:
    """`$EDGE_CACHE_DIR`, else `$XDG_CACHE_HOME/edge-vln`, else `~/.cache/edge-vln`."""
    if explicit := os.environ.get("EDGE_CACHE_DIR"):
        return Path(explicit).expanduser()
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "edge-vln"


def models_dir() -> Path:
    """Where ONNX files and own cards are kept: never in git."""
    return cache_dir() / "models"
