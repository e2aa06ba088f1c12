"""Where things lie: ready configurations, model cards, and the cache."""

from __future__ import annotations

import os
from pathlib import Path

from edge.errors import ConfigError

PACKAGE = Path(__file__).resolve().parents[1]


def data_dir(kind: str) -> Path:
    """The folder of `config` or `models`: inside an installed wheel, or in a clone."""
    packaged = PACKAGE / "_data" / kind
    return packaged if packaged.is_dir() else PACKAGE.parent / kind


def find_config(name_or_path: str) -> Path:
    """A configuration file by path, or a ready one by name or file name."""
    path = expand(name_or_path)
    if path.exists():
        return path
    ready = data_dir("config") / f"{path.stem}.yaml"
    if ready.exists():
        return ready
    names = ", ".join(sorted(p.stem for p in data_dir("config").glob("*.yaml")))
    raise ConfigError(f"{name_or_path}: no such file (ready configurations: {names})")


def expand(path: str | Path) -> Path:
    """The path with `~` replaced by the home folder.

    Raises:
        ConfigError: it begins with `~`, and there is no home folder.
    """
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise ConfigError(
            f"{path}: user {os.getuid()} has no home folder: set HOME, or give the path in full"
        ) from None


def user_cache() -> Path | None:
    """`$XDG_CACHE_HOME`, else `~/.cache`; None for a user without a home folder."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    except RuntimeError:
        return None


def cache_dir() -> Path:
    """`$EDGE_CACHE_DIR`, else `edge-vln` in the user's cache.

    Raises:
        ConfigError: neither is there.
    """
    if explicit := os.environ.get("EDGE_CACHE_DIR"):
        return expand(explicit)
    if (cache := user_cache()) is not None:
        return cache / "edge-vln"
    raise ConfigError(
        f"user {os.getuid()} has no home folder: set EDGE_CACHE_DIR to a folder for models that it "
        "can read and write"
    )


def models_dir() -> Path:
    """Where ONNX files and own cards are kept: never in git."""
    return cache_dir() / "models"
