"""A house of two rooms in which an episode takes a second."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from simulated import simulated

from edge.config import Config
from edge.lab.eval.closed_loop import ClosedLoop
from edge.memory import Site

BOX = [(0, 0), (8, 0), (8, 4), (0, 4)]
HOUSE = {
    "name": "small",
    "start": [1.0, 2.0, 0.0],
    "rooms": [
        {"name": "living room", "rect": [0, 0, 4, 4]},
        {"name": "bedroom", "rect": [4, 0, 8, 4]},
    ],
    "walls": [
        *({"start": a, "end": b} for a, b in zip(BOX, BOX[1:] + BOX[:1], strict=True)),
        {"start": (4, 0), "end": (4, 1.4)},
        {"start": (4, 2.6), "end": (4, 4)},
    ],
    "objects": [{"category": "sofa", "at": [2, 3.4]}, {"category": "bed", "at": [6.8, 2.0]}],
}


def small_house(folder: Path, **sections: Any) -> Config:
    """Write a configuration with that house and the simulator's detector."""
    path = folder / "small.json"
    path.write_text(json.dumps(HOUSE))
    sim = {"world": {"kind": "house", "house": str(path)}, **sections.pop("sim", {})}
    return simulated({"sim": sim, **sections})


def driven(
    instruction: str, *items, seconds: float = 150.0, folder: Path | None = None
) -> ClosedLoop:
    """Drive a mission in the built-in house, or in the small one, written to a folder."""
    sections = {
        "loop": {"lockstep": True},
        "sim": {"lockstep": True, "step_s": 0.2},
        "mission": {"instruction": instruction, "translator": {"kind": "grammar"}},
        "sensors": {"camera": {"width_px": 160, "height_px": 128}},  # sees enough
    }
    config = simulated(sections) if folder is None else small_house(folder, **sections)
    return ClosedLoop(config, colour=False, site=Site(items)).run(seconds)
