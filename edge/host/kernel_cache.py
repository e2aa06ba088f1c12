"""Where compiled kernels are kept: without a place numba refuses to load them at all."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from edge.errors import ConfigError
from edge.host import resources
from edge.host.private_folder import private_folder

log = logging.getLogger(__name__)

_VARIABLE = "NUMBA_CACHE_DIR"


@contextmanager
def kernel_cache() -> Iterator[None]:
    """Have numba find a folder, in this block and in processes started in it.

    Numba takes what `NUMBA_CACHE_DIR` names, else `__pycache__` beside the code, else the user's
    cache. Where the code is read-only and the user has no home that can be written, that is
    `$EDGE_CACHE_DIR`, or a temporary folder, with a warning.

    Raises:
        ConfigError: no folder can be written.
    """
    if _numba_finds_one():
        yield
        return
    with ExitStack() as stack:
        stack.callback(_set, os.environ.get(_VARIABLE))
        _set(str(_ours() or _temporary(stack)))
        yield


def _numba_finds_one() -> bool:
    home = resources.user_cache()
    places = [resources.PACKAGE / "__pycache__", *([home / "numba"] if home else [])]
    if named := os.environ.get(_VARIABLE):
        places.append(Path(named))
    return any(map(_writable, places))


def _ours() -> Path | None:
    if not os.environ.get("EDGE_CACHE_DIR"):
        return None
    folder = resources.cache_dir() / "kernels"
    return folder if _writable(folder) else None


def _temporary(stack: ExitStack) -> Path:
    todo = f"set EDGE_CACHE_DIR (or {_VARIABLE}) to a folder that user {os.getuid()} can write"
    try:
        folder = stack.enter_context(private_folder("edge-kernels-"))
    except OSError as error:
        raise ConfigError(f"no folder for compiled kernels ({error.strerror}): {todo}") from None
    log.warning("neither code nor home can be written, so kernels are compiled anew at each start, "
                "which takes tens of seconds: %s", todo)  # fmt: skip
    return folder


def _writable(folder: Path) -> bool:
    """Whether it can be written, or made."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK, effective_ids=True)


def _set(value: str | None) -> None:
    if value is None:
        os.environ.pop(_VARIABLE, None)
    else:
        os.environ[_VARIABLE] = value
