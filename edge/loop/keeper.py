"""Between a running mission and its checkpoint: what is kept, when, and how it goes on."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from pathlib import Path

from edge.config import Config
from edge.errors import UserError
from edge.geometry import SE2
from edge.mission import ltl
from edge.mission.brief import Brief, MissionError, brief_of
from edge.mission.checkpoint import CheckpointWriter, continuous, load
from edge.mission.run import MissionRun
from edge.mission.saved import Saved, restore_instance, save_instances
from edge.mission.translate import Translation
from edge.perception.instances import InstanceTracker
from edge.text import one_line
from edge.types import Instance, MissionStatus, Observation

log = logging.getLogger("edge.loop.keeper")


class Keeper:
    """Has the state of the mission written: at once when it changes, else each second.

    Attributes:
        saved: the unfinished mission that the checkpoint held and that goes on; else None.
        problem: why a checkpoint that was there is of no use, "" where there is none such.
    """

    def __init__(self, config: Config, path: Path, asked: str | None) -> None:
        """
        Args:
            asked: what was asked for on the command line; None where nothing was. A checkpoint of
                another mission then gives way.

        Raises:
            CheckpointError: there is a file and it cannot be read, or none can be written.
        """
        self._config = config
        loaded = load(path)
        self.problem = loaded.problem
        self.saved = _to_go_on_with(loaded.saved, asked)
        self._places = self.saved
        self._writer = CheckpointWriter(path)
        self._kept: tuple[MissionRun, int] | None = None

    def brief(self) -> Brief | None:
        """The saved mission again, from its formula: nothing is translated twice.

        Raises:
            MissionError: the limits in the configuration are narrower than they were.
        """
        if (saved := self.saved) is None:
            return None
        formula = ltl.parse(saved.formula)
        translation = Translation(saved.instruction, formula, saved.english, saved.backend)
        try:
            return brief_of(self._config.mission, translation)
        except UserError as error:
            raise MissionError(
                f"mission.checkpoint: {self._writer.path}: its mission cannot go on: {error}; "
                "move the file away to begin without it"
            ) from None

    def resume(self, mission: MissionRun) -> None:
        """Set the mission to where it was; what was seen comes back with the first observation."""
        if (saved := self.saved) is not None:
            mission.id = saved.id
            mission.restore(
                saved.word, saved.reached, saved.failed, saved.elapsed_s, saved.path_m, saved.paused
            )
            log.info("going on with the mission: %s (state %d, reached: %s)",
                     one_line(saved.instruction), mission.state,
                     one_line(", ".join(saved.reached)) or "nothing yet")  # fmt: skip

    def restore_places(
        self, mission: MissionRun, tracker: InstanceTracker, observation: Observation
    ) -> None:
        """Put the instances back if the robot's odometry is still the one they were seen in."""
        saved, self._places = self._places, None
        if saved is None:
            return
        pose = observation.pose
        here = (pose.x_m, pose.y_m, pose.yaw_rad)
        robot, source = self._config.robot, self._config.source
        if continuous(
            saved, here, observation.stamp_ns, robot.max_speed_mps, source.max_pose_jump_m
        ):
            for instance in saved.instances:
                tracker.adopt(restore_instance(instance, observation.stamp_ns))
            mission.overlook(max((i.id for i in saved.instances), default=-1))
        else:
            log.info("the pose is not where it was: what was seen before the restart is dropped")

    def note(
        self,
        mission: MissionRun,
        status: MissionStatus,
        seen: Iterable[Instance],
        pose: SE2 | None,
        stamp_ns: int,
        epoch: int,
        now_ns: int,
    ) -> None:
        """Hand the state to the writer if it is time. Never blocks.

        Args:
            seen: every instance.
            pose: in `map`, at `stamp_ns` of the sensors' clock; None before there was any.
            epoch: counts the frames that the map was in.
            now_ns: the loop's time.
        """
        kept, self._kept = self._kept, (mission, mission.changes)
        unchanged = kept is not None and kept[0] is mission and kept[1] == mission.changes
        if unchanged and not self._writer.due(now_ns):
            return
        # Only references are taken here: instances replace their arrays and never write into them.
        instances = [copy(i) for i in seen]
        brief, pending = mission.brief, self._places
        word, reached, failed = mission.word, mission.reached, mission.failed
        detected, paused, name = mission.detected, mission.paused, mission.id

        def made() -> Saved:
            saved = Saved(
                instruction=brief.translation.instruction,
                formula=str(brief.automaton.formula),
                backend=brief.translation.backend,
                english=brief.translation.english,
                word=word,
                reached=reached,
                failed=tuple(sorted(failed)),
                detected=tuple(sorted(detected)),
                target=status.target,
                phase=status.phase,
                reason=status.reason,
                paused=paused,
                elapsed_s=status.elapsed_s,
                path_m=status.path_m,
                pose=None if pose is None else (pose.x_m, pose.y_m, pose.yaw_rad),
                stamp_ns=stamp_ns,
                odometry_epoch=epoch,
                instances=save_instances(instances),
                id=name,
            )
            if pending is None:
                return saved
            # Nothing was observed since the restart: the places are still those of before.
            return replace(
                saved,
                pose=pending.pose,
                stamp_ns=pending.stamp_ns,
                odometry_epoch=pending.odometry_epoch,
                instances=pending.instances,
            )

        self._writer.post(made, now_ns)

    def status(self) -> dict[str, object]:
        """For the status message."""
        writer = self._writer
        problem = writer.problem or self.problem
        return {
            "path": str(writer.path), "written": writer.written, "failed": writer.failed,
            "problem": problem,
        }  # fmt: skip

    def close(self) -> None:
        """Write what waits."""
        self._writer.close()


def _to_go_on_with(saved: Saved | None, asked: str | None) -> Saved | None:
    if saved is None or saved.phase in ("idle", "reached", "failed"):
        return None
    if asked is not None and asked != saved.instruction:
        log.info("the checkpoint's mission (%s) gives way to the new one",
                 one_line(saved.instruction))  # fmt: skip
        return None
    return saved
