"""Memory after many model swaps: each swap returns all that it used."""

from __future__ import annotations

import shutil

import pytest
import yaml
from fresh_process import run_fresh

from edge.host import resources

pytest.importorskip("onnxruntime")
pytestmark = pytest.mark.slow

SHIPPED = "mini-house-256x320-int8-cpu"
# The allocator has found its size by half of them, give or take 5 MB; each model kept takes 10.
SPREAD_MB = 16.0


@pytest.fixture
def names(tmp_path, monkeypatch) -> tuple[str, str]:
    """Return two names for the shipped model."""
    shipped = resources.data_dir("models")
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir()
    for name in ("first", "second"):
        card = yaml.safe_load((shipped / f"{SHIPPED}.yaml").read_text())
        card.update(name=name, file=f"{name}.onnx")
        (resources.models_dir() / f"{name}.yaml").write_text(yaml.safe_dump(card))
        shutil.copy(shipped / f"{SHIPPED}.onnx", resources.models_dir() / f"{name}.onnx")
    return "first", "second"


@pytest.mark.parametrize(("isolation", "swaps"), [("thread", 12), ("process", 6)])
def test_memory_and_descriptors_are_flat_over_many_swaps(names, isolation, swaps):
    told = run_fresh("swap_soak.py", isolation, swaps, *names)
    settled_mb = told["resident_mb"][swaps // 2 :]
    assert max(settled_mb) - settled_mb[0] < SPREAD_MB, told
    descriptors = told["descriptors"]
    assert max(descriptors[1:]) <= descriptors[0], told
