"""Checkpoints of training runs: files with the state and the identity of a run.

A checkpoint only continues its own run. A model from a run that went on with other images, another
plan or another number of processes could not be made again by a command.

Keys in addition to the states of the network and the optimizer:
    step: int, number of steps done.
    plan: dict, the fields of the run's plan, a dataclass.
    ranks: int, processes that shared each batch.
    frames: int, training images.
    device: str, as PyTorch names it.
    seconds: float, training time so far.
    torch, machine: str, PyTorch's version and the processor's architecture.
"""

from __future__ import annotations

import pickle
import platform
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import nn

from edge.host.files import replace_atomically
from exporters.files import ExportError

SAME = ("ranks", "frames", "device")
"""Keys that must be equal to continue a run, in addition to those of the plan."""
KEYS = ("model", "averaged", "step", "plan", *SAME, "seconds", "torch", "machine")
"""Keys that every checkpoint has."""

Run = dict[str, Any]
"""Identity of a run; see `run_identity`."""


def run_identity(plan: Any, frames: int, ranks: int, device: str) -> Run:
    """Return the identity of a run, in types that `torch.load` reads without running code."""
    return {"plan": asdict(plan), "ranks": ranks, "frames": frames, "device": device}


def load(path: Path, device: str = "cpu") -> dict[str, Any]:
    """Return a checkpoint with at least the keys `KEYS`; raise ExportError if it is none."""
    try:
        checkpoint = torch.load(path, map_location=device, weights_only=True)
    except (OSError, EOFError, RuntimeError, ValueError, pickle.UnpicklingError):
        raise ExportError(
            f"{path}: not a readable checkpoint; remove the file, or use another --out"
        ) from None
    missing = [key for key in KEYS if key not in checkpoint]
    if missing:
        raise ExportError(
            f"{path}: a checkpoint of an older version (without {', '.join(missing)}); use "
            "another --out"
        )
    return checkpoint


def resume(path: Path, run: Run, device: str = "cpu") -> dict[str, Any] | None:
    """Return the checkpoint to continue from; None if there is none yet.

    Raises:
        ExportError: the checkpoint is of another run; the message names a key that differs.
    """
    if not path.is_file():
        return None
    checkpoint = load(path, device)
    stored, wanted = (
        {**each["plan"], **{key: each[key] for key in SAME}} for each in (checkpoint, run)
    )
    for key in {**stored, **wanted}:
        if stored.get(key) != wanted.get(key):
            raise ExportError(
                f"{path}: the checkpoint of another run: {key} is {stored.get(key)} there and "
                f"{wanted.get(key)} now; use another --out"
            )
    return checkpoint


def save(path: Path, state: dict[str, Any], run: Run, step: int, seconds: float) -> None:
    """Write a checkpoint atomically; `state` has objects with a `state_dict`."""
    tools = {"torch": str(torch.__version__), "machine": platform.machine()}
    checkpoint = {name: each.state_dict() for name, each in state.items()}
    with replace_atomically(path) as part:
        torch.save({**checkpoint, **run, **tools, "step": step, "seconds": seconds}, part)


def averaged(path: Path, model: nn.Module) -> dict[str, Any]:
    """Load a run's averaged weights into `model`, for inference; return the checkpoint."""
    checkpoint = load(path)
    model.load_state_dict(checkpoint["averaged"])
    model.eval().requires_grad_(False)
    return checkpoint


def made_by(checkpoint: dict[str, Any]) -> dict[str, Any]:
    """Return a card's entries for the training time and the machine."""
    minutes = round(checkpoint["seconds"] / 60)
    return {"minutes": minutes, "torch": checkpoint["torch"], "machine": checkpoint["machine"]}
