"""Load shedder: it drops expensive work when the computer cannot keep up, and restores it later.

`perception.load_shedding.levels` lists the work to drop, in order. Each entry is a degradation
level. The module `edge.loop.degradation` decides when to step. A cheaper model is swapped in as by
`edge models use`, without waiting. If a user swaps in another model, the load shedder waits until
the model of its level runs again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from statistics import median

from edge.config import PerceptionConfig
from edge.host.board import BoardReading, read_board, throttling_reason
from edge.host.worker import Worker
from edge.loop.degradation import DegradationLevels, LevelChange, LoadSample
from edge.loop.scorers import Scorers
from edge.loop.status import detector_health
from edge.perception.runtime.cards import ModelError, install_hint, load_detector_card
from edge.perception.swap.base import FINAL_STATES, SwapError
from edge.perception.swap.detector import DetectorSwap
from edge.perception.worker import DetectorWorker

SECOND_NS = 1_000_000_000
BOARD_S = 2.0
MARGIN_C = 3.0  # a board this near to its throttling temperature is in distress
COOL_C = 5.0  # a board is cool if it is this much below the limit of distress
_MOST_TIMES = 256  # largest number of detector times in a second


class LoadShedder:
    """The load shedder; for the loop's thread. It never waits.

    Args:
        perception: The configuration, with degradation levels.
        worker: Background worker of the detector.
        swapper: Swaps the detector's model.
        scorers: The scorers, which a level may pause.
        tell: Reports each step, one line, at a loop time.
        board: Reads the computer's sensors, on its own thread.

    Raises:
        ModelError: A level names a model that is not on this computer.

    Attributes:
        steps: Number of steps, by direction.
    """

    def __init__(
        self,
        perception: PerceptionConfig,
        worker: DetectorWorker,
        swapper: DetectorSwap,
        scorers: Scorers | None,
        tell: Callable[[str, int], None],
        board: Callable[[], BoardReading] = read_board,
    ) -> None:
        self._perception = perception
        self._entries = perception.load_shedding.levels
        for name in filter(None, (entry.model for entry in self._entries)):
            _check_here(name)
        self._worker, self._swapper, self._scorers = worker, swapper, scorers
        self._log = tell
        self.steps = {"down": 0, "up": 0}
        self._why = ""
        self._unfit: set[str] = set()
        self._times_ms: deque[float] = deque(maxlen=_MOST_TIMES)
        self._done = 0
        self._begun_ns = 0
        self._move: LevelChange | None = None  # the step that waits for its model
        self._seen: BoardReading | None = None
        self._distress, self._cool = "", True
        self._board: Worker[bool, BoardReading] = Worker("board", lambda _: board(), rest_s=BOARD_S)
        self._restart()

    def reconfigure(self, perception: PerceptionConfig) -> None:
        """Use another configuration with the same levels. Its detector already runs."""
        before, self._perception = self._perception, perception
        self._levels.budget_ms = perception.swap.budget_ms
        parts = ("detector", "isolation", "process")
        if any(getattr(before, part) != getattr(perception, part) for part in parts):
            self._restart()

    @property
    def level(self) -> int:
        """Current level; 0: nothing is dropped."""
        return self._levels.level

    def step(self, now_ns: int) -> None:
        """Measure the load and take the next step if it is due, between two ticks."""
        self._measure()
        self._check_board(now_ns)
        if self._move is not None:
            self._follow(self._move, now_ns)
        elif self._waiting:
            self._begin_second(now_ns)
        elif now_ns - self._begun_ns >= SECOND_NS:
            second = self._second()
            self._begin_second(now_ns)
            move = self._levels.update(second, now_ns)
            if move is not None:
                self._begin(move, now_ns)

    def status(self) -> dict[str, object]:
        """Return the part of the status message."""
        return {
            "level": self.level,
            "levels": len(self._entries),
            "state": "stepping" if self._move else "waiting" if self._waiting else "steady",
            "why": self._why,
            "distress": self._distress,
            "paused": sorted(self._paused(self.level)),
            "power_mode": None if self._seen is None else self._seen.power_mode,
            "steps": dict(self.steps),
        }

    def close(self) -> None:
        """Stop reading the board. Wait `BOARD_S` at most, since a sensor may hang."""
        self._board.close(timeout_s=BOARD_S)

    @property
    def _waiting(self) -> bool:
        """True if another swap runs, or if the current model is not that of the level."""
        wanted = self._model_on(self.level)
        running = wanted is None or self._swapper.running == wanted
        return not running or self._swapper.state not in ("idle", *FINAL_STATES)

    def _restart(self) -> None:
        """Restart at level 0, whose model runs."""
        detector = self._perception.detector
        self._model = detector.model if detector.kind == "onnx" else None
        self._levels = DegradationLevels(len(self._entries), self._perception.swap.budget_ms)
        self._unfit.clear()
        self._move = None
        self._pause(0)

    def _measure(self) -> None:
        stats = self._worker.stats
        if stats.done != self._done:
            self._done = stats.done
            self._times_ms.append(stats.last_latency_ns * 1e-6)

    def _check_board(self, now_ns: int) -> None:
        if self._board.idle:
            self._board.submit(True)
        board = self._board.poll()
        if board is None:
            return
        before, self._seen = self._seen, board
        self._distress = throttling_reason(board, before, MARGIN_C)
        self._cool = not throttling_reason(board, before, MARGIN_C + COOL_C)
        if before is not None and board.power_mode != before.power_mode:
            self._levels.reset_times()
            self._log(
                f"load shedding: power mode {board.power_mode}, was {before.power_mode}", now_ns
            )

    def _second(self) -> LoadSample:
        """Return the load since the last call."""
        took_ms = median(self._times_ms) if self._times_ms else None
        state, detail = detector_health(self._worker)
        ill = f"the detector is degraded: {detail}" if state == "degraded" else ""
        return LoadSample(took_ms, ill or self._distress, self._cool)

    def _begin_second(self, now_ns: int) -> None:
        self._begun_ns = now_ns
        self._times_ms.clear()

    def _begin(self, move: LevelChange, now_ns: int) -> None:
        down = move.level > self.level
        paused = self._entries[max(move.level, self.level) - 1].pause
        wanted = self._model_on(move.level)
        what = f"model {wanted}"
        if paused is not None:
            what = f"pause {paused}" if down else f"resume {paused}"
        where = f"{'down' if down else 'up'} to level {move.level} of {len(self._entries)}"
        self._why = f"{where}: {what}: {move.why}"
        self._log(f"load shedding: {self._why}", now_ns)
        if wanted in (None, self._swapper.running):
            self._arrive(move, now_ns)
            return
        try:
            self._swapper.request(wanted, True, now_ns)
        except SwapError as error:
            self._abort(move, str(error), now_ns)
        else:
            self._move = move

    def _follow(self, move: LevelChange, now_ns: int) -> None:
        """Check the swap that a step waits for."""
        swap = self._swapper.status()
        if swap["state"] not in FINAL_STATES:
            return
        if swap["state"] == "kept":
            self._arrive(move, now_ns)
            return
        if move.level > self.level:
            self._unfit.add(str(swap["model"]))  # the next level is tried without it
        self._abort(move, str(swap["detail"]), now_ns)

    def _arrive(self, move: LevelChange, now_ns: int) -> None:
        self.steps["down" if move.level > self.level else "up"] += 1
        self._move = None
        self._levels.arrived(move.level, now_ns)
        self._pause(move.level)
        self._begin_second(now_ns)

    def _abort(self, move: LevelChange, why: str, now_ns: int) -> None:
        self._move = None
        self._why = f"level {move.level} cannot be used: {why}"
        self._log(f"load shedding: {self._why}", now_ns)
        if self._model_on(move.level) == self._swapper.running:  # the level is usable otherwise
            self._arrive(move, now_ns)
        else:
            self._levels.change_failed(now_ns)
            self._begin_second(now_ns)

    def _model_on(self, level: int) -> str | None:
        """Return the model of a level, or None if the detector has no model."""
        named = [r.model for r in self._entries[:level] if r.model and r.model not in self._unfit]
        return named[-1] if named else self._model

    def _paused(self, level: int) -> frozenset[str]:
        return frozenset(r.pause for r in self._entries[:level] if r.pause)

    def _pause(self, level: int) -> None:
        if self._scorers is not None:
            self._scorers.shed = self._paused(level)


def _check_here(name: str) -> None:
    card = load_detector_card(name)
    if card.server is None and not card.is_here():
        raise ModelError(
            f"{card.path}: model {name} of perception.load_shedding.levels is not on this "
            f"computer; {install_hint(card)}"
        )
