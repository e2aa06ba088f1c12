"""Fixtures of the exporter tests: everything they need, or a skip that says what is missing."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from edge.host import resources

os.environ["YOLO_AUTOINSTALL"] = "false"
EXPORT = re.compile(r"^pytestmark = .*pytest\.mark\.export", re.MULTILINE)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Modules of which no test is wanted: to read them costs each worker seconds of imports."""
    if collection_path.suffix == ".py" and "not export" in config.option.markexpr:
        return bool(EXPORT.search(collection_path.read_text("utf-8"))) or None
    return None


@pytest.fixture(scope="session")
def weights(shared_dir: Path) -> Path:
    """YOLO-World's checkpoint; skips without it or without torch and ultralytics."""
    for module in ("torch", "ultralytics", "onnxslim", "onnxruntime"):
        pytest.importorskip(module, reason=f"{module} is not installed (extra `export`)")
    path = shared_dir / "models" / "yolov8s-worldv2.pt"
    if not path.is_file():
        pytest.skip(f"test data not there: {path.name}")
    return path


@pytest.fixture(scope="session")
def vocabulary(shared_dir: Path) -> Path:
    """CLIP text embeddings of common words."""
    path = shared_dir / "models" / "clip_vitb32_vocab.npz"
    if not path.is_file():
        pytest.skip(f"test data not there: {path.name}")
    return path


@pytest.fixture(scope="session")
def photos(shared_dir: Path) -> Path:
    """Return a folder with a few real photographs of rooms."""
    path = shared_dir / "logs" / "redwood_rgbd" / "color"
    if not path.is_dir():
        pytest.skip(f"test data not there: {path.name}/")
    return path


@pytest.fixture
def models(cache: Path, monkeypatch) -> Path:
    """Return the folder of the models that the module's fixture `cache` has exported."""
    monkeypatch.setenv("EDGE_CACHE_DIR", str(cache))
    return resources.models_dir()
