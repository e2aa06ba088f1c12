"""Starts the worker processes, one for each variant."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from edge.config import DetectorOnnx
from edge.host.children import python_module
from edge.models.bench.figures import Measured
from edge.models.bench.variants import PROVIDERS, Variant
from edge.perception.cards import how_to_get

WORKER = python_module("edge.models.bench.worker")


class Bench:
    """Runs variants over the same frames."""

    def __init__(
        self,
        folder: Path,
        rgb: Sequence[np.ndarray],
        prompts: Sequence[str],
        settings: DetectorOnnx,
        tau_det: float,
        limit_s: float,
    ) -> None:
        """
        Args:
            folder: for files that pass between the processes.
            rgb: (h, w, 3) uint8 each.
            settings: but for `model` and `providers`.
            tau_det: boxes at or below it are left out.
            limit_s: a worker that takes longer is ended.
        """
        self._settings, self._limit_s = settings, limit_s
        self._job_file, self._out = folder / "job.json", folder / "out.npz"
        frames = folder / "frames.npz"
        np.savez(frames, **{f"f{k}": image for k, image in enumerate(rgb)})
        self._job = {
            "prompts": list(prompts),
            "frames": str(frames),
            "out": str(self._out),
            "tau_det": tau_det,
        }

    def run(self, variant: Variant) -> Measured | str:
        """What was measured, or in one line why nothing was."""
        if not variant.card.is_here():
            return f"not here: {how_to_get(variant.card)}"
        asked = {"model": variant.card.name, "providers": PROVIDERS[variant.on]}
        job = {**self._job, "detector": self._settings.model_copy(update=asked).model_dump()}
        self._job_file.write_text(json.dumps(job), encoding="utf-8")
        self._out.unlink(missing_ok=True)
        command = [*WORKER, str(self._job_file)]
        try:
            done = subprocess.run(
                command, stdout=subprocess.PIPE, text=True, errors="replace", check=False,
                timeout=self._limit_s,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            limit = "perception.swap.load_timeout_s and a bit for each frame"
            return f"failed: not done after {self._limit_s:g} s ({limit})"
        if done.returncode or not self._out.is_file():
            return f"failed: {_reason(done)}"
        with np.load(self._out) as file:
            return Measured.read(file)


def _reason(done: subprocess.CompletedProcess[str]) -> str:
    """Why a worker ended: its signal, or its last line on stdout."""
    if done.returncode < 0:
        return f"its process was ended by signal {-done.returncode}"
    lines = [line.strip() for line in done.stdout.splitlines() if line.strip()]
    return lines[-1] if lines else f"exit code {done.returncode}"
