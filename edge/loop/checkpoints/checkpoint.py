"""Checkpoint of a running service: saved while it runs, restored at the start.

It has three files with different lifetimes. The mission's file is small and is written when the
mission changes. The map's file, next to it, holds all data in the frame `map`
(`map_checkpoint`). The third one, written rarely, holds the pictures of the objects
(`crop_checkpoint`). A finished mission is saved too.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from pathlib import Path

from edge.config import Config
from edge.errors import UserError
from edge.host.checkpoint import Checkpoint, CheckpointWriter, load
from edge.loop.checkpoints import crop_checkpoint
from edge.loop.checkpoints.map_checkpoint import SUFFIX, MapCheckpoint, MapParts, StampedPose
from edge.memory import CropStore
from edge.mission.checkpoint import MISSION, TRANSLATION_ATTRIBUTES, MissionState, restore, state_of
from edge.mission.instructions import MissionError
from edge.mission.logic import ltl
from edge.mission.run import MissionRun
from edge.mission.spec import MissionSpec, spec_of
from edge.mission.translate import Translation
from edge.tasks.mission_spec import prepare_task
from edge.text import one_line
from edge.types import MissionStatus

log = logging.getLogger("edge.loop.checkpoints.checkpoint")


class ServiceCheckpoint:
    """The checkpoint of the mission, saved at once when it changes, else each second.

    Attributes:
        saved: Unfinished mission of the file that will continue; None if there is none.
        problem: Reason why an existing file cannot be used; "" if there is no problem.
        crops: Checkpoint of the objects' pictures.
    """

    def __init__(self, config: Config, path: Path, instruction: str | None) -> None:
        """Load the files and start their writers.

        Args:
            config: The configuration.
            path: Path of the mission's file.
            instruction: Instruction on the command line, or None. It replaces a saved mission with
                another instruction.

        Raises:
            CheckpointError: A file cannot be read, or cannot be written.
        """
        self._config = config
        text = config.model_dump_json(exclude={"path"})
        self._fingerprint = hashlib.sha256(text.encode()).hexdigest()[:16]
        loaded, self.problem = load(path, MISSION)
        self.saved = None if loaded is None else _unfinished(loaded.state, instruction)
        self.map = MapCheckpoint(config, path.with_name(path.name + SUFFIX), self._fingerprint)
        crops = path.with_name(path.name + crop_checkpoint.SUFFIX)
        self.crops = crop_checkpoint.CropCheckpoint(crops)
        self._newest_crops: CropStore | None = None  # to write when the service ends
        self._writer = CheckpointWriter(path, MISSION)
        self._resumed: MissionRun | None = None
        # The mission whose state was queued last, and its `changes` then.
        self._queued: tuple[MissionRun, int] | None = None

    def saved_spec(self) -> MissionSpec | None:
        """Return the saved mission, ready to run, or None.

        It is made from its formula, without another translation. A task is read again and continues
        with the first step that was not driven.

        Raises:
            MissionError: The limits in the configuration are narrower than they were.
        """
        if (saved := self.saved) is None:
            return None
        try:
            if saved.task:
                return prepare_task(self._config, saved.instruction)
            known = {name: getattr(saved, name) for name in TRANSLATION_ATTRIBUTES}
            translation = Translation(formula=ltl.parse(saved.formula), **known)
            return spec_of(self._config.mission, translation)
        except UserError as error:
            raise MissionError(
                f"mission.checkpoint: {self._writer.path}: the saved mission cannot continue: "
                f"{error}; move the file away to start without it"
            ) from None

    def resume(self, mission: MissionRun) -> None:
        """Restore the mission; the map comes back with the first observation."""
        self.map.prepare()
        if (saved := self.saved) is not None:
            self._resumed = mission
            restore(mission, saved)
            log.info("continuing the saved mission: %s (in state %d of its automaton; reached: %s)",
                     one_line(saved.instruction), mission.progress.state,
                     one_line(", ".join(saved.reached)) or "nothing yet")  # fmt: skip

    def is_resumed(self, mission: MissionRun, targets: Sequence[str] | None = None) -> bool:
        """Return True for the saved mission, with these targets of the saved map if given."""
        return mission is self._resumed and targets in (None, mission.spec.prompts)

    def save_if_due(
        self,
        mission: MissionRun,
        status: MissionStatus,
        parts: MapParts,
        last_pose: StampedPose | None,
        now_ns: int,
    ) -> None:
        """Queue the state for writing if it changed or a second has passed. Never block.

        Args:
            mission: The mission.
            status: Its status.
            parts: Parts of the map's checkpoint.
            last_pose: Pose and stamp of the newest observation; None before the first.
            now_ns: Loop time.
        """
        queued, self._queued = self._queued, (mission, mission.changes)
        changed = queued is None or queued[0] is not mission or queued[1] != mission.changes
        if last_pose is not None:
            self.map.step(parts, last_pose, mission.spec.prompts, mission.target, changed)
        if self.map.waiting is None:  # else the saved pictures are not restored yet
            self._newest_crops = parts.map.crops
            self.crops.save_if_changed(parts.map.crops, now_ns)
        if not (changed or self._writer.is_due(now_ns)):
            return
        state = state_of(mission, status.phase)
        self._writer.post(lambda: Checkpoint(state, config=self._fingerprint), now_ns)

    def status(self) -> dict[str, object]:
        """Return the part of the status message."""
        writer, map_checkpoint, crops = self._writer, self.map, self.crops
        problems = (
            writer.problem, map_checkpoint.writer.problem, map_checkpoint.problem, self.problem,
            crops.writer.problem, crops.problem,
        )  # fmt: skip
        return {
            "path": str(writer.path), "written": writer.written, "failed": writer.failed,
            "problem": next(filter(None, problems), ""),
        }  # fmt: skip

    def close(self) -> None:
        """Write the last state and stop the writers."""
        self.map.close()
        self.crops.close(self._newest_crops)
        self._writer.close()


def _unfinished(saved: MissionState, instruction: str | None) -> MissionState | None:
    """Return the saved mission if it is unfinished and not replaced by another instruction."""
    if saved.phase in ("idle", "reached", "failed"):
        return None
    if instruction is not None and instruction != saved.instruction:
        log.info("the saved mission (%s) is replaced by the new one",
                 one_line(saved.instruction))  # fmt: skip
        return None
    return saved
