"""The decorator of all compiled kernels."""

from __future__ import annotations

from functools import partial, wraps
from typing import Any

from numba import njit
from numba.core.caching import IndexDataCacheFile

jit: Any = partial(njit, nogil=True, cache=True)
"""`numba.njit` that releases the GIL and caches the compiled code on disk.

Use it as `@jit`, or as `@jit(...)` with further options of `njit`."""


def _ignore_stale_indexes(load: Any) -> Any:
    """Return numba's reader of cached kernels, without its crash after an update of this package.

    The index of the kernels that an older version compiled may name a class that is gone. Numba
    reads these names before it notices that the source has changed, and raises AttributeError.
    """

    @wraps(load)
    def load_index(self: Any) -> dict[Any, str]:
        try:
            return load(self)
        except (AttributeError, ImportError):
            return {}

    return load_index


if hasattr(IndexDataCacheFile, "_load_index"):  # not public; without it, stale kernels raise
    IndexDataCacheFile._load_index = _ignore_stale_indexes(IndexDataCacheFile._load_index)
