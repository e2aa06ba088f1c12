"""Missions of `edge soak`, one after another: sentences about the objects of the house."""

from __future__ import annotations

import logging
import time
from typing import Any

import numpy as np

from edge import names
from edge.bus.client import RequestError
from edge.config import Config, DetectorOnnx
from edge.errors import UserError
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
_MOST_NAMES = 2  # in a sentence
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
        # By number of the house.
        self._labels = {0: known_labels(harness.config, harness.config.sim.world)}

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
        sentence = SENTENCES[self._rng.integers(len(SENTENCES))]
        return sentence.format(*self._rng.permutation(self._known_labels())[:_MOST_NAMES])

    def _known_labels(self) -> list[str]:
        """Return the labels of the present house; if these are too few, those of the first."""
        harness = self._harness
        if harness.house not in self._labels:
            try:
                self._labels[harness.house] = known_labels(harness.config, harness.world)
            except UserError as error:  # the robot searches in vain until it is in another house
                log.warning("%s", error)
                self._labels[harness.house] = self._labels[0]
        return self._labels[harness.house]


def known_labels(config: Config, section: Any) -> list[str]:
    """Return the labels of a world's objects that the detector knows, sorted.

    `section` is the world's section `sim.world`.

    Raises:
        UserError: they are too few for `SENTENCES`.
    """
    sim = config.sim.model_copy(update={"world": section})
    world = load_world(config.model_copy(update={"sim": sim}))
    labels = {obj.label for obj in world.objects}
    detector, key = config.perception.detector, "sim.world"
    if isinstance(detector, DetectorOnnx):
        key = "perception.detector.background"
        known = set(map(names.canonical, detector.background))
        labels = {label for label in labels if names.canonical(label) in known}
    if len(labels) < _MOST_NAMES:
        raise UserError(
            f"{config.locate(key)}: edge soak needs {_MOST_NAMES} objects of the world "
            f"{world.name} that the detector knows, got {', '.join(sorted(labels)) or 'none'}"
        )
    return sorted(labels)
