"""What a training run keeps of itself: how far it is, and which run it is.

A checkpoint goes on only as the run that it is of: with other pictures, another plan or another
number of processes it would become a model that no command makes again.

Keys besides the state of the network and the optimizer:
    step: int, how many are done.
    plan: dict, the fields of the run's plan, a dataclass.
    ranks: int, processes that shared each batch.
    frames: int, pictures trained on.
    device: str, as PyTorch names it.
    seconds: float, trained so far.
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
"""Keys that must be the same when a run goes on, besides the plan's."""
KEYS = ("model", "averaged", "step", "plan", *SAME, "seconds", "torch", "machine")

Run = dict[str, Any]


def describe(plan: Any, frames: int, ranks: int, device: str) -> Run:
    """What makes a run the run it is, in types that `torch.load` takes without running code."""
    return {"plan": asdict(plan), "ranks": ranks, "frames": frames, "device": device}


def load(path: Path, device: str = "cpu") -> dict[str, Any]:
    """A checkpoint with the keys `KEYS` at least; raises ExportError if it is none."""
    try:
        kept = torch.load(path, map_location=device, weights_only=True)
    except (OSError, EOFError, RuntimeError, ValueError, pickle.UnpicklingError):
        raise ExportError(
            f"{path}: cannot be read as a checkpoint; remove it or use another --out"
        ) from None
    missing = [key for key in KEYS if key not in kept]
    if missing:
        raise ExportError(
            f"{path}: of an older version (has no {', '.join(missing)}); use another --out"
        )
    return kept


def resume(path: Path, run: Run, device: str = "cpu") -> dict[str, Any] | None:
    """The checkpoint to go on from, None where there is none yet.

    Raises:
        ExportError: it is of another run; the text names a key that differs.
    """
    if not path.is_file():
        return None
    kept = load(path, device)
    had, has = ({**of["plan"], **{key: of[key] for key in SAME}} for of in (kept, run))
    for key in {**had, **has}:
        if had.get(key) != has.get(key):
            raise ExportError(
                f"{path}: of another run: {key} was {had.get(key)} and is {has.get(key)}; "
                "use another --out"
            )
    return kept


def save(path: Path, state: dict[str, Any], run: Run, step: int, seconds: float) -> None:
    """Write a checkpoint atomically; `state` has `state_dict`s."""
    made_by = {"torch": str(torch.__version__), "machine": platform.machine()}
    kept = {name: thing.state_dict() for name, thing in state.items()}
    with replace_atomically(path) as part:
        torch.save({**kept, **run, **made_by, "step": step, "seconds": seconds}, part)


def averaged(path: Path, model: nn.Module) -> dict[str, Any]:
    """Load a run's averaged weights into `model`, to be used; return all that the checkpoint says.

    Raises:
        ExportError: it is none.
    """
    kept = load(path)
    model.load_state_dict(kept["averaged"])
    model.eval().requires_grad_(False)
    return kept


def made_by(kept: dict[str, Any]) -> dict[str, Any]:
    """Return what a card says of how long a run took, and on what."""
    minutes = round(kept["seconds"] / 60)
    return {"minutes": minutes, "torch": kept["torch"], "machine": kept["machine"]}
