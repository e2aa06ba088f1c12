"""Recorded runs, for tests that read them."""

from __future__ import annotations

from pathlib import Path

from simulated import simulated

from edge.config import Config
from edge.lab.eval.closed_loop import ClosedLoop
from edge.recording.rolling import files_of
from edge.sinks.mcap import McapSink


def small(**sections: dict | list) -> Config:
    """Return a simulated run in lockstep, with small images."""
    base = {
        "loop": {"lockstep": True},
        "sim": {"lockstep": True, "step_s": 0.2},
        "sensors": {"camera": {"width_px": 80, "height_px": 64}},
        "mission": {"target": "bed"},
    }
    merged = {**base, **sections}
    return simulated(
        {k: {**base.get(k, {}), **v} if isinstance(v, dict) else v for k, v in merged.items()}
    )


class Recording:
    """A closed loop that is recorded as it steps."""

    def __init__(self, folder: Path, config: Config | None = None, **options: object) -> None:
        self.config = config or small()
        self.folder = folder
        self.sink = McapSink(self.config, str(folder), **options)
        self.closed = ClosedLoop(self.config, sinks=[self.sink])
        self.service = self.closed.service

    def steps(self, n: int) -> Recording:
        for _ in range(n):
            self.closed.step()
        return self

    def close(self) -> Path:
        """Close the recording; return its first file."""
        self.closed.close()
        self.sink.close()
        return files_of(self.folder)[0]
