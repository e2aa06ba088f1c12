"""Stages `detect` to `score`: from an observation to objects, and to the candidates' scores."""

from __future__ import annotations

from time import perf_counter_ns

import numpy as np

from edge.config import Config
from edge.loop.input_log import DETECTOR, InputLog
from edge.loop.latency import LatencyRing
from edge.loop.scoring.scorers import Scorers
from edge.loop.semantic_map import SemanticMap
from edge.loop.stages import DETECT
from edge.mapping.results import MapUpdate
from edge.mission.run import MissionRun
from edge.perception.worker import DetectorWorker
from edge.policies.base import Policy, PolicyInput, ScorerOutputs, scores_of
from edge.types import Detections, Observation

NOTHING_CHANGED = (0, 0, 0, 0)
"""`MapUpdate.changed` of a tick in which no cell changed."""


class PerceptionStages:
    """The stages that read sensor data and ask models; for the loop's thread.

    Args:
        worker: Runs the detector in the background; `submit` and `poll` never wait for the model.
    Attributes:
        images: Number of images of each camera that the detector has processed, as of this tick.
        policy: Scores the candidates; may be replaced.
        scorers: Models that are queried in the background; None if none is configured.
        detections: New detections of this tick, without suppressed ones; None if there are none.
            Their frame is held until `release`.
        scores: (n,) float32, the policy's scores of the candidates.
    """

    def __init__(
        self,
        config: Config,
        semantic_map: SemanticMap,
        worker: DetectorWorker,
        policy: Policy,
        scorers: Scorers | None,
        latency: LatencyRing,
        input_log: InputLog,
    ) -> None:
        self._lockstep, self._n_cameras = config.loop.lockstep, len(config.sensors.cameras)
        self.policy, self.scorers = policy, scorers
        self._map, self._latency = semantic_map, latency
        self._input_log = input_log
        self.worker = input_log.wrap(DETECTOR, worker)
        self.images, self.scores = 0, np.zeros(0, np.float32)
        self.detections: Detections | None = None
        self._changed_cells = NOTHING_CHANGED
        self._newest_seq = -1
        # Newest observation before the last pose jump: boxes up to it are in the old frame.
        self._last_seq_before_jump = -1

    def begin(self, observation: Observation) -> None:
        """Take note of the newest observation, even if it is then refused."""
        self._newest_seq = observation.seq

    def detect(self, observation: Observation) -> None:
        """Stage `detect`: pass the image to the detector."""
        self.worker.submit(observation)
        # In lockstep the model runs inside `submit`. This time counts for `detect`, not the tick.
        self._latency.exclude_elapsed(perf_counter_ns())

    def map(self, observation: Observation, now_ns: int) -> MapUpdate | None:
        """Stage `map`: integrate the depth image or cloud into the map."""
        update = self._map.update(observation, now_ns)
        self._changed_cells = NOTHING_CHANGED if update is None else update.changed
        return update

    def lift(self, mission: MissionRun) -> None:
        """Stage `lift`: turn new boxes into instances (objects in the map).

        The depth and pose of the boxes' own image are used, not those of this tick.
        """
        self.release()
        detections = self.worker.poll()
        if detections is not None:
            try:
                is_in_old_frame = detections.observation.seq <= self._last_seq_before_jump
                if not is_in_old_frame and detections.prompts == mission.spec.prompts:
                    self._latency.span(DETECT, detections.latency_ns)
                    if self.scorers is not None:
                        self.scorers.on_detections(detections, self._map.grid.values)
                    self._map.on_detections(detections)
                    self.detections = detections.without_suppressed()
            finally:
                if self.detections is None:  # else the frame is held until `release`
                    detections.observation.release()
        done = self.worker.stats.done
        self.images = done // self._n_cameras
        self._input_log.note("images", done=done)

    def ask_scorers(self, mission: MissionRun, observation: Observation) -> None:
        """Before the stage `score`: ask the scorers, and collect their answers."""
        if self.scorers is None:
            return
        semantic_map, values = self._map, self._map.grid.values
        if mission.active:
            targets, candidates = mission.spec.prompts, semantic_map.pool.candidates
            target = mission.spec.prompt_for(mission.target)
            self.scorers.ask(
                observation, targets, target, candidates, semantic_map.tracker, values,
                semantic_map.prior, semantic_map.objects.read_only,
            )  # fmt: skip
        self.scorers.collect_answers(values, idle=mission.done)
        if self._lockstep:  # the models ran inside `ask`, which is no time of the tick
            self._latency.exclude_elapsed(perf_counter_ns())

    def score(self, mission: MissionRun, observation: Observation, now_ns: int) -> PolicyInput:
        """Stage `score`: build the policy's context and score the candidates."""
        context = PolicyInput(
            observation,
            observation.pose,
            self._map.view,
            self._changed_cells,
            self._map.pool.read_only,
            self.detections,
            ScorerOutputs() if self.scorers is None else self.scorers.answers,
            mission.spec.prompts,
            mission.spec.prompt_for(mission.target),
            now_ns,
            self._map.objects.read_only,
            self._map.prior,
        )
        self.scores = scores_of(self.policy, context)
        return context

    def begin_mission(self) -> None:
        """Drop detections, answers and open questions, which were for the last mission."""
        self.release()
        if self.scorers is not None:
            self.scorers.discard_pending()

    def release(self) -> None:
        """Forget the tick's detections; their frame can be reused."""
        if self.detections is not None:
            self.detections.observation.release()
            self.detections = None

    def on_pose_jump(self) -> None:
        """Drop answers and open questions, and detections in images up to the newest one.

        They are in the old frame.
        """
        self._last_seq_before_jump = self._newest_seq
        if self.scorers is not None:
            self.scorers.discard_pending()
