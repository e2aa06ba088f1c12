"""The folder for compiled kernels; without a folder, numba refuses to load kernels."""

from __future__ import annotations

import logging
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edge.errors import ConfigError
from edge.host import resources

log = logging.getLogger(__name__)

_VARIABLE = "NUMBA_CACHE_DIR"


@contextmanager
def kernel_cache() -> Iterator[None]:
    """Give numba a folder for compiled kernels, in this block and in processes started in it.

    Numba uses `NUMBA_CACHE_DIR`, else `__pycache__` next to the code, else the user's cache. If
    none of these can be written, `$EDGE_CACHE_DIR` is used, else a folder in that for temporary
    files, with a warning.

    Raises:
        ConfigError: no folder can be written.
    """
    if _numba_finds_folder():
        yield
        return
    before = os.environ.get(_VARIABLE)
    _set_variable(str(_own_folder() or _temporary_folder()))
    try:
        yield
    finally:
        _set_variable(before)


def _numba_finds_folder() -> bool:
    home = resources.user_cache()
    folders = [resources.PACKAGE / "__pycache__", *([home / "numba"] if home else [])]
    if configured := os.environ.get(_VARIABLE):
        folders.append(Path(configured))
    return any(map(_is_writable, folders))


def _own_folder() -> Path | None:
    if not os.environ.get("EDGE_CACHE_DIR"):
        return None
    folder = resources.cache_dir() / "kernels"
    return folder if _is_writable(folder) else None


def _temporary_folder() -> Path:
    """Return this user's folder for temporary kernels; all processes and later starts share it."""
    advice = f"set EDGE_CACHE_DIR (or {_VARIABLE}) to a folder that user {os.getuid()} can write"
    folder = Path(tempfile.gettempdir(), f"edge-kernels-{os.getuid()}")
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise ConfigError(f"no folder for compiled kernels ({error.strerror}): {advice}") from None
    # Code that another user could write would run with the rights of this one.
    if found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o077:
        raise ConfigError(f"{folder}: other users can write here: {advice}")
    log.warning("compiled kernels are in %s; if it is emptied, they are compiled again, for tens "
                "of seconds: %s", folder, advice)  # fmt: skip
    return folder


def _is_writable(folder: Path) -> bool:
    """Return True if the folder can be written, or created."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK, effective_ids=True)


def _set_variable(value: str | None) -> None:
    if value is None:
        os.environ.pop(_VARIABLE, None)
    else:
        os.environ[_VARIABLE] = value
