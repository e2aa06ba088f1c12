"""Missions one after another, in sentences about the objects of the house."""

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

FORMS = (
    "go to the {0}",
    "find the {0}",
    "go to the {0}, then to the {1}",
    "go to the {0} or the {1}",
)
_AGAIN_S = 2.0  # before a failed request is repeated, and for status to follow a new mission
_OVER = ("reached", "failed")


class MissionFeeder:
    """Gives the service a mission whenever it has none.

    Attributes:
        ended: the end of each mission: `instruction`, `phase`, `reason`, `elapsed_s`, `path_m`.
    """

    def __init__(self, stage: SoakHarness, watch: SoakMonitor, rng: np.random.Generator) -> None:
        self.ended: list[dict[str, Any]] = []
        self._stage, self._watch, self._rng = stage, watch, rng
        self._asked_s = time.monotonic()
        self._words: dict[int, list[str]] = {}

    def step(self) -> dict[str, Any] | None:
        """Give the next mission if the last has ended. Return that end, or None."""
        status = self._watch.status
        fresh = self._watch.status_s > self._asked_s + _AGAIN_S
        if not fresh or status.get("phase") not in _OVER:
            return None
        end = {
            key: status[key] for key in ("instruction", "phase", "reason", "elapsed_s", "path_m")
        }
        try:
            self._stage.mission(do="new", instruction=self._next())
        except RequestError as error:  # because of a fault: try again later
            log.debug("%s", error)
            return None
        finally:  # translation may take longer than the period of status messages
            self._asked_s = time.monotonic()
        self.ended.append(end)
        return end

    def _next(self) -> str:
        words = self._here()
        form = FORMS[self._rng.integers(len(FORMS))]
        return form.format(*self._rng.permutation(words)[:2])

    def _here(self) -> list[str]:
        """Return the labels of the house's objects that the detector knows, sorted."""
        stage = self._stage
        if stage.house not in self._words:
            sim = stage.config.sim.model_copy(update={"world": stage.world})
            world = load_world(stage.config.model_copy(update={"sim": sim}))
            labels = {thing.label for thing in world.objects}
            detector = stage.config.perception.detector
            if isinstance(detector, DetectorOnnx):
                known = set(map(names.canonical, detector.background))
                labels = {label for label in labels if names.canonical(label) in known}
            self._words[stage.house] = sorted(labels)
        return self._words[stage.house]
