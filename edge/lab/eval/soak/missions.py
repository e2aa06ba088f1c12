"""Missions of `edge soak`, one after another: sentences about the objects of the house."""

from __future__ import annotations

import logging
import time
from typing import Any

import numpy as np

from edge import names
from edge.bus.client import RequestError
from edge.config import DetectorOnnx
from edge.lab.eval.soak.harness import SoakHarness
from edge.lab.eval.soak.monitor import SoakMonitor
from edge.lab.sim.worlds import load_world

log = logging.getLogger("edge.lab.eval.soak")

SENTENCES = (
    "go to the {0}",
    "find the {0}",
    "go to the {0}, then to the {1}",
    "go to the {0} or the {1}",
)
_RETRY_S = 2.0  # before a failed request is repeated, and for status to follow a new mission
_OVER = ("reached", "failed")


class MissionFeeder:
    """Gives the service a mission whenever it has none.

    Attributes:
        ended: the end of each mission: `instruction`, `phase`, `reason`, `elapsed_s`, `path_m`.
    """

    def __init__(
        self, harness: SoakHarness, monitor: SoakMonitor, rng: np.random.Generator
    ) -> None:
        self.ended: list[dict[str, Any]] = []
        self._harness, self._monitor, self._rng = harness, monitor, rng
        self._asked_s = time.monotonic()
        self._labels: dict[int, list[str]] = {}

    def step(self) -> dict[str, Any] | None:
        """Give the next mission if the last has ended; return how that ended, or None."""
        status = self._monitor.status
        # An older status may still be that of the mission before.
        fresh = self._monitor.status_s > self._asked_s + _RETRY_S
        if not fresh or status.get("phase") not in _OVER:
            return None
        end = {
            key: status[key] for key in ("instruction", "phase", "reason", "elapsed_s", "path_m")
        }
        try:
            self._harness.request_mission(do="new", instruction=self._next_instruction())
        except RequestError as error:  # because of a fault: try again later
            log.debug("%s", error)
            return None
        finally:  # translation may take longer than the period of status messages
            self._asked_s = time.monotonic()
        self.ended.append(end)
        return end

    def _next_instruction(self) -> str:
        labels = self._known_labels()
        sentence = SENTENCES[self._rng.integers(len(SENTENCES))]
        return sentence.format(*self._rng.permutation(labels)[:2])

    def _known_labels(self) -> list[str]:
        """Return the labels of the house's objects that the detector knows, sorted."""
        harness = self._harness
        if harness.house not in self._labels:
            sim = harness.config.sim.model_copy(update={"world": harness.world})
            world = load_world(harness.config.model_copy(update={"sim": sim}))
            labels = {obj.label for obj in world.objects}
            detector = harness.config.perception.detector
            if isinstance(detector, DetectorOnnx):
                known = set(map(names.canonical, detector.background))
                labels = {label for label in labels if names.canonical(label) in known}
            self._labels[harness.house] = sorted(labels)
        return self._labels[harness.house]
