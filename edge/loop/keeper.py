"""Between a running service and its checkpoint: what is kept, when, and how it goes on.

Two files, since they outlive different things: the mission's, small and written whenever it
changes, and beside it that of all that is bound to `map` (`edge.loop.places`), which a robot whose
mission is over keeps too.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from edge.config import Config
from edge.errors import UserError
from edge.loop.place_keeper import SUFFIX, PlaceKeeper
from edge.loop.places import Now, Parts
from edge.mission.brief import Brief, MissionError, brief_of
from edge.mission.checkpoint import CheckpointWriter, load
from edge.mission.logic import ltl
from edge.mission.run import MissionRun
from edge.mission.saved import Saved
from edge.mission.translate import Translation
from edge.tasks.brief import prepare_task
from edge.text import one_line
from edge.types import MissionStatus

log = logging.getLogger("edge.loop.keeper")


class Keeper:
    """Has the state of the mission written: at once when it changes, else each second.

    Attributes:
        saved: the unfinished mission that the checkpoint held and that goes on; else None.
        problem: why a checkpoint that was there is of no use, "" where there is none such.
        places: keeps what is bound to `map`.
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
        self.places = PlaceKeeper(config, path.with_name(path.name + SUFFIX))
        self._writer = CheckpointWriter(path)
        self._resumed: MissionRun | None = None
        self._kept: tuple[MissionRun, int] | None = None

    def brief(self) -> Brief | None:
        """The saved mission again, from its formula: nothing is translated twice. A task is read
        again, and goes on with the first step that was not driven.

        Raises:
            MissionError: the limits in the configuration are narrower than they were.
        """
        if (saved := self.saved) is None:
            return None
        try:
            if saved.task:
                return prepare_task(self._config, saved.instruction)
            formula = ltl.parse(saved.formula)
            translation = Translation(
                saved.instruction, formula, saved.english, saved.backend, reading=saved.reading,
                readings=saved.readings, implied=saved.implied,
            )  # fmt: skip
            return brief_of(self._config.mission, translation)
        except UserError as error:
            raise MissionError(
                f"mission.checkpoint: {self._writer.path}: its mission cannot go on: {error}; "
                "move the file away to begin without it"
            ) from None

    def resume(self, mission: MissionRun) -> None:
        """Set the mission to where it was; what was seen comes back with the first observation."""
        self.places.prepare()
        if (saved := self.saved) is not None:
            mission.id = saved.id
            self._resumed = mission
            mission.restore(
                saved.word, saved.reached, saved.failed, saved.elapsed_s, saved.path_m, saved.paused
            )
            log.info("going on with the mission: %s (state %d, reached: %s)",
                     one_line(saved.instruction), mission.state,
                     one_line(", ".join(saved.reached)) or "nothing yet")  # fmt: skip

    def goes_on(self, mission: MissionRun, targets: Sequence[str]) -> bool:
        """Whether this is the mission that the checkpoint held, and places were kept for it."""
        return mission is self._resumed and tuple(targets) == mission.brief.targets

    def note(
        self,
        mission: MissionRun,
        status: MissionStatus,
        parts: Parts,
        now: Now | None,
        now_ns: int,
    ) -> None:
        """Hand the state to the writers if it is time. Never blocks.

        Args:
            now: the newest observation's; None before there was any.
            now_ns: the loop's time.
        """
        kept, self._kept = self._kept, (mission, mission.changes)
        changed = kept is None or kept[0] is not mission or kept[1] != mission.changes
        if now is not None:
            self.places.note(parts, now, mission.brief.targets, mission.target, changed)
        if not (changed or self._writer.due(now_ns)):
            return
        brief = mission.brief
        word, reached, failed = mission.word, mission.reached, mission.failed
        detected, paused, name = mission.detected, mission.paused, mission.id

        def made() -> Saved:
            return Saved(
                instruction=brief.translation.instruction,
                formula=str(brief.automaton.formula),
                backend=brief.translation.backend,
                english=brief.translation.english,
                reading=brief.translation.reading,
                readings=brief.translation.readings,
                implied=brief.translation.implied,
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
                id=name,
                task=brief.steps is not None,
            )

        self._writer.post(made, now_ns)

    def status(self) -> dict[str, object]:
        """For the status message."""
        writer, places = self._writer, self.places
        problem = writer.problem or places.trouble or self.problem
        return {
            "path": str(writer.path), "written": writer.written, "failed": writer.failed,
            "places_written": places.written,
            "problem": problem,
        }  # fmt: skip

    def close(self) -> None:
        """Write what waits."""
        self.places.close()
        self._writer.close()


def _to_go_on_with(saved: Saved | None, asked: str | None) -> Saved | None:
    if saved is None or saved.phase in ("idle", "reached", "failed"):
        return None
    if asked is not None and asked != saved.instruction:
        log.info("the checkpoint's mission (%s) gives way to the new one",
                 one_line(saved.instruction))  # fmt: skip
        return None
    return saved
