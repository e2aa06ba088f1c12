"""The state of a mission in a checkpoint, from which it continues after a restart."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated

from pydantic import ConfigDict, Field

from edge.errors import UserError
from edge.host.checkpoint import CheckpointFormat
from edge.mission.destinations import Destination
from edge.mission.logic.automaton import NOTHING
from edge.mission.logic.ltl import parse, propositions
from edge.mission.repetition import Repetition
from edge.mission.run import MissionRun
from edge.text import bounded_repr

# Types that check the file's values.
ShortText = Annotated[str, Field(max_length=1000)]
NotNegative = Annotated[float, Field(ge=0)]
Names = Annotated[tuple[ShortText, ...], Field(max_length=10_000)]


@dataclass(frozen=True)
class MissionState:
    """A saved mission.

    Attributes:
        instruction: see `edge.mission.translate.Translation`, which also describes `backend`,
            `english`, `reading`, `readings` and `implied`.
        repeat: see `edge.mission.translate.Translation`; `round` is the current round.
        destinations: see `edge.mission.run.MissionRun`.
        formula: text of the automaton's formula.
        trace: reached propositions and `NOTHING`, oldest first. The automaton's state is not
            saved. It follows from the trace, even if a later compiler numbers states differently.
        reached: R of ViTL III; a subset of the formula's propositions, like `failed` and
            `detected`.
        failed: B of ViTL III; `lost` is its part that fails in all rounds.
        detected: D of ViTL III.
        target: the pursued proposition, or None.
        paused: True if the mission was paused.
        elapsed_s: time that counts towards the time limit.
        path_m: path that counts towards the path limit.
        id: see `edge.mission.run.MissionRun`.
        exempt_s: see `edge.mission.meter.MissionMeter`, like `exempt_m`, `pursued_s` and `ends_ns`.
        results: see `edge.mission.run.MissionRun`.
        task: True for a task (`edge.tasks`). Its `trace` has one `NOTHING` for each driven step.
    """

    __pydantic_config__ = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)

    instruction: str
    formula: str
    backend: ShortText
    english: str
    trace: Names
    reached: Names
    failed: Names
    detected: Names
    target: ShortText | None
    phase: ShortText
    reason: str
    paused: bool
    elapsed_s: NotNegative
    path_m: NotNegative
    reading: Annotated[int, Field(ge=1)] | None = None
    readings: tuple[str, ...] = ()
    implied: bool = False
    destinations: Annotated[dict[ShortText, Destination], Field(max_length=100)] = field(
        default_factory=dict
    )
    id: ShortText = ""
    task: bool = False
    exempt_s: NotNegative = 0.0
    exempt_m: NotNegative = 0.0
    repeat: Repetition | None = None
    round: Annotated[int, Field(ge=1)] = 1
    results: tuple[str, ...] = ()
    pursued_s: dict[ShortText, NotNegative] = field(default_factory=dict)
    lost: Names = ()
    ends_ns: dict[ShortText, Annotated[int, Field(ge=0, lt=1 << 63)]] = field(default_factory=dict)


TRANSLATION_ATTRIBUTES = (
    "instruction", "backend", "english", "reading", "readings", "implied", "destinations", "repeat",
)  # fmt: skip
"""Attributes that `MissionState` takes from the mission's `Translation`."""
# Attributes that `MissionState` takes unchanged from the `MissionRun`.
_RUN_ATTRIBUTES = ("target", "reason", "paused", "id", "results")
_METER_ATTRIBUTES = ("elapsed_s", "path_m", "exempt_s", "exempt_m")


def state_of(mission: MissionRun, phase: str) -> MissionState:
    """Return the current state of the mission for a checkpoint; `phase` is the run's phase."""
    spec = mission.spec
    return MissionState(
        formula=str(spec.automaton.formula), phase=phase,
        task=spec.steps is not None,
        failed=tuple(sorted(mission.sets.failed)), detected=tuple(sorted(mission.sets.detected)),
        lost=tuple(sorted(mission.sets.lost)),
        **{name: getattr(spec.translation, name) for name in TRANSLATION_ATTRIBUTES}
        | {"destinations": dict(mission.destinations)},
        **{name: getattr(mission, name) for name in _RUN_ATTRIBUTES},
        **{name: getattr(mission.meter, name) for name in _METER_ATTRIBUTES},
        trace=mission.progress.trace, round=mission.progress.round,
        pursued_s=dict(mission.meter.pursued_s), ends_ns=dict(mission.meter.ends_ns),
        reached=mission.sets.reached,
    )  # fmt: skip


def restore(mission: MissionRun, saved: MissionState) -> None:
    """Continue from the saved state of a mission with the same formula; call it before `start`."""
    for reached in saved.trace:
        mission.progress.advance(reached)
    mission.progress.round = saved.round
    mission.sets.restore(saved.reached, saved.failed, saved.lost)
    mission.id, mission.results, mission.paused = saved.id, saved.results, saved.paused
    for name in _METER_ATTRIBUTES:
        setattr(mission.meter, name, getattr(saved, name))
    mission.meter.pursued_s, mission.meter.ends_ns = dict(saved.pursued_s), dict(saved.ends_ns)


def _check(state: MissionState) -> None:
    """Raise a one-line ValueError if a set has a name that is not in the formula."""
    names = _propositions_of(state.formula)
    if state.task:
        return
    for name in ("trace", "reached", "failed", "lost", "detected"):
        unknown = set(getattr(state, name)) - names - ({NOTHING} if name == "trace" else set())
        if unknown:
            raise ValueError(f"{name}: {bounded_repr(min(unknown), 60)} is not in the formula")
    if state.target is not None and state.target not in names:
        raise ValueError(f"target: {bounded_repr(state.target, 60)} is not in the formula")


@lru_cache(maxsize=4)
def _propositions_of(formula: str) -> frozenset[str]:
    """Return the propositions of a formula; raise ValueError if its text cannot be parsed."""
    try:
        return frozenset(propositions(parse(formula)))
    except UserError as error:
        raise ValueError(f"formula: {error}") from None


MISSION = CheckpointFormat("edge-mission", "checkpoint of a mission", MissionState, 8 << 20, _check)
"""The format of the checkpoint file."""
