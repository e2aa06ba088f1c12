"""Gazebo worlds and models, written for the tests."""

from __future__ import annotations

from pathlib import Path

BOX = "<geometry><box><size>1 2 3</size></box></geometry>"


def visual(shape: str = BOX, more: str = "") -> str:
    return f"<visual name='v'>{more}{shape}</visual>"


def model(name: str, body: str = "", pose: str = "") -> str:
    """Return a model with one link; without a body it is a box."""
    pose = pose and f"<pose>{pose}</pose>"
    return f"<model name='{name}'>{pose}<link name='link'>{body or visual()}</link></model>"


def write_world(path: Path, body: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"<sdf version='1.6'><world name='w'>{body}</world></sdf>")
    return path


def write_model(models: Path, name: str, body: str = "", pose: str = "") -> Path:
    """Write a model's folder, and return it."""
    folder = models / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.sdf").write_text(f"<sdf version='1.6'>{model(name, body, pose)}</sdf>")
    return folder
