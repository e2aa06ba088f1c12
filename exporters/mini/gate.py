"""What a model of our own must be able to do before it takes the shipped one's place."""

from __future__ import annotations

from collections.abc import Mapping

from exporters.files import ExportError

FLOORS = {"ap50": 0.7, "pairs_told_apart": 0.8}
"""Least value of a card's figures on held-out houses."""
MAX_BYTES = 2_900_000


def check_gate(held_out: Mapping[str, float], step: int, steps: int) -> None:
    """Raise ExportError that says all that is wrong.

    Args:
        held_out: the card's figures on held-out houses.
        step, steps: how many training steps are done, and how many its plan has.
    """
    faults = [] if step >= steps else [f"step {step} of {steps}"]
    faults += [f"{key} {held_out[key]} < {floor}" for key, floor in FLOORS.items()
               if not held_out[key] >= floor]  # fmt: skip
    if held_out["bytes"] > MAX_BYTES:
        faults.append(f"{held_out['bytes']} bytes > {MAX_BYTES}")
    if faults:
        raise ExportError(
            f"{'; '.join(faults)}: not put in place; train on with exporters.train_mini, "
            "or give --no-gate"
        )
