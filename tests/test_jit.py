"""Compiled kernels are kept, also when the classes of their arguments get other names."""

from __future__ import annotations

import importlib
import os
import sys

import pytest

SOURCE = """
from typing import NamedTuple

from edge.jit import jit


class {name}(NamedTuple):
    x: int


@jit
def double(pair):
    return 2 * pair.x
"""


@pytest.fixture
def load(tmp_path, monkeypatch):
    """`load(name)` imports again the module of a kernel that takes a class of this name."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    path = tmp_path / "module_of_kernel.py"

    def load(name: str, second: int):
        path.write_text(SOURCE.format(name=name))
        os.utime(path, (second, second))
        sys.modules.pop(path.stem, None)
        importlib.invalidate_caches()
        return importlib.import_module(path.stem)

    yield load
    sys.modules.pop(path.stem, None)


def test_a_kernel_is_recompiled_if_its_classes_are_gone(load):
    compiled = []
    for second, name in enumerate(("Before", "Before", "After")):
        # The second module is the same as the first, and numba compares size and time.
        module = load(name, 1_000_000 + second // 2)
        assert module.double(getattr(module, name)(21)) == 42
        compiled.append(sum(module.double.stats.cache_misses.values()))
    assert compiled == [1, 0, 1]
