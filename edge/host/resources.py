"""Paths of the built-in configurations and model cards, and of the cache."""

from __future__ import annotations

import os
from pathlib import Path

from edge.errors import ConfigError

PACKAGE = Path(__file__).resolve().parents[1]


def data_dir(kind: str) -> Path:
    """Return a folder of built-in data, in an installed wheel or in a clone."""
    packaged = PACKAGE / "_data" / kind
    return packaged if packaged.is_dir() else PACKAGE.parent / kind


def find_config(name_or_path: str) -> Path:
    """Return a configuration file by path, or a built-in one by name; raise ConfigError if none."""
    path = expand(name_or_path)
    builtin = data_dir("config") / f"{path.stem}.yaml"
    # A folder `demo` in the working directory does not hide the built-in name `demo`.
    is_name = "/" not in str(name_or_path) and path.is_dir()
    if path.exists() and not (is_name and builtin.exists()):
        return path
    if builtin.exists():
        return builtin
    names = ", ".join(sorted(p.stem for p in data_dir("config").glob("*.yaml")))
    raise ConfigError(f"{name_or_path}: no such file (built-in configurations: {names})")


def expand(path: str | Path) -> Path:
    """Return the path with `~` replaced by the home folder.

    Raises:
        ConfigError: the path begins with `~`, but the user has no home folder.
    """
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise ConfigError(
            f"{path}: user {os.getuid()} has no home folder: set HOME, or give the path in full"
        ) from None


def user_cache() -> Path | None:
    """Return `$XDG_CACHE_HOME`, else `~/.cache`; None for a user without a home folder."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    except RuntimeError:
        return None


def cache_dir() -> Path:
    """Return `$EDGE_CACHE_DIR`, else the folder `edge-vln` in the user's cache.

    Raises:
        ConfigError: `$EDGE_CACHE_DIR` is not set, and the user has no home folder.
    """
    if explicit := os.environ.get("EDGE_CACHE_DIR"):
        return expand(explicit)
    if (cache := user_cache()) is not None:
        return cache / "edge-vln"
    raise ConfigError(
        f"user {os.getuid()} has no home folder: set EDGE_CACHE_DIR to a folder that it can "
        "read and write"
    )


def models_dir() -> Path:
    """Return the folder of ONNX files and of your own cards."""
    return cache_dir() / "models"
