"""The folder for compiled kernels; without a folder, numba refuses to load kernels."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from edge.errors import ConfigError
from edge.host import resources

log = logging.getLogger(__name__)

_VARIABLE = "NUMBA_CACHE_DIR"


@contextmanager
def kernel_cache() -> Iterator[None]:
    """Give numba a folder for compiled kernels, in this block and in processes started in it.

    Numba uses `NUMBA_CACHE_DIR`, else `__pycache__` next to the code, else the user's cache. If
    none of these can be written, `$EDGE_CACHE_DIR` is used, else a temporary folder, with a
    warning.

    Raises:
        ConfigError: no folder can be written.
    """
    if _numba_finds_folder():
        yield
        return
    with ExitStack() as stack:
        stack.callback(_set_variable, os.environ.get(_VARIABLE))
        _set_variable(str(_own_folder() or _temporary_folder(stack)))
        yield


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


def _temporary_folder(stack: ExitStack) -> Path:
    advice = f"set EDGE_CACHE_DIR (or {_VARIABLE}) to a folder that user {os.getuid()} can write"
    try:
        folder = stack.enter_context(
            tempfile.TemporaryDirectory(prefix="edge-kernels-", ignore_cleanup_errors=True)
        )
    except OSError as error:
        raise ConfigError(f"no folder for compiled kernels ({error.strerror}): {advice}") from None
    log.warning("no folder can keep compiled kernels, so each start compiles them again, for tens "
                "of seconds: %s", advice)  # fmt: skip
    return Path(folder)


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
