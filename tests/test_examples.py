"""Every example in a docstring of `edge` runs with the shown result."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import edge

ROOT = Path(edge.__file__).parent
MODULES = sorted(
    ".".join(("edge", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__")
    for path in ROOT.rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


def test_examples_are_found():
    assert "edge.names" in MODULES
    assert len(MODULES) > 80


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_are_true(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    failed, tried = doctest.testmod(importlib.import_module(name))
    assert tried > 0
    assert failed == 0
