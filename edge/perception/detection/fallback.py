"""A detector on a server, with one on this computer for the time in which the server fails."""

from __future__ import annotations

from collections.abc import Sequence

from edge.perception.detection.detector import Detector
from edge.perception.detection.remote import RemoteDetector
from edge.perception.runtime.fallback import FallbackModel
from edge.perception.runtime.health import ModelHealth
from edge.types import Detections, Observation


class FallbackDetector:
    """A detector (`Detector`) of two; see `FallbackModel`. Both get all prompts.

    `Detections.model` names the one that has detected.
    """

    def __init__(self, remote: RemoteDetector, local: Detector) -> None:
        self.name = remote.name
        self._remote, self._local = remote, local
        self._models: FallbackModel[Observation, Detections] = FallbackModel(
            "detector", remote.name, local.name, remote.detect,
            Observation.hold, Observation.release,
        )  # fmt: skip

    @property
    def prompts(self) -> tuple[str, ...]:
        return self._local.prompts

    @property
    def invalid_boxes(self) -> int:
        return self._remote.invalid_boxes + self._local.invalid_boxes

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """See `Detector.set_prompts`; if one of the two refuses the prompts, both keep theirs."""
        before = self._local.prompts
        self._local.set_prompts(prompts)
        try:
            self._remote.set_prompts(prompts)
        except Exception:
            self._local.set_prompts(before)
            raise

    def detect(self, observation: Observation) -> Detections:
        return self._models.ask(observation, lambda: self._local.detect(observation))

    def health(self) -> ModelHealth:
        """Return the health of the detector in use; with a detail while it is the local one."""
        detail = self._models.detail
        if not detail:
            return self._remote.health()
        local = self._local.health()
        return ModelHealth("ok", detail) if local.state == "ok" else local

    def close(self) -> None:
        """Abort the server's current answer, and close both."""
        self._remote.close()
        self._models.close()
        self._local.close()
