"""Load shedder: it drops expensive work when the computer cannot keep up, and restores it later.

`perception.load_shedding.levels` lists the work to drop, in order. Each entry is a degradation
level. The module `edge.loop.degradation` decides when to change the level. A cheaper model is
swapped in as by `edge models use`; the loop does not wait for it. If a user swaps in a model that
the current level does not have, the load shedder does nothing until the level's model runs again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from statistics import median

from edge.config import PerceptionConfig
from edge.host.board import BoardReading, read_board, throttling_reason
from edge.host.worker import Worker
from edge.loop.degradation import DegradationLevels, LevelChange, LoadSample
from edge.loop.scoring.scorers import Scorers
from edge.loop.status import detector_health
from edge.perception.runtime.cards import ModelError, install_hint, load_detector_card
from edge.perception.swap.base import FINAL_STATES, SwapError
from edge.perception.swap.detector import DetectorSwap
from edge.perception.worker import DetectorWorker

SECOND_NS = 1_000_000_000  # period of the measurement of the load
BOARD_S = 2.0  # time between two readings of the board's sensors
MARGIN_C = 3.0  # a board this near to its throttling temperature is in distress
COOL_C = 5.0  # a board is cool if it is this much below the limit of distress
_MAX_TIMES = 256  # largest number of detector times in a second


class LoadShedder:
    """The load shedder; for the loop's thread. It never waits.

    Args:
        perception: The configuration, with degradation levels.
        scorers: The scorers, which a level may pause.
        event: Reports each change of the level: one line, and the loop time [ns].
        board: Reads the computer's sensors, on its own thread.

    Raises:
        ModelError: A level names a model that is not on this computer.

    Attributes:
        steps: Number of changes of the level since the start, by direction.
    """

    def __init__(
        self,
        perception: PerceptionConfig,
        worker: DetectorWorker,
        detector_swap: DetectorSwap,
        scorers: Scorers | None,
        event: Callable[[str, int], None],
        board: Callable[[], BoardReading] = read_board,
    ) -> None:
        self._perception = perception
        self._settings = perception.load_shedding.levels
        for name in filter(None, (entry.model for entry in self._settings)):
            _check_model_is_here(name)
        self._worker, self._detector_swap, self._scorers = worker, detector_swap, scorers
        self._event = event
        self.steps = {"down": 0, "up": 0}
        self._last_change = ""
        self._unfit_models: set[str] = set()  # models whose swap for a level failed
        self._detector_ms: deque[float] = deque(maxlen=_MAX_TIMES)
        self._n_detected = 0
        self._measured_from_ns = 0
        self._pending_change: LevelChange | None = None  # waits for its model
        self._reading: BoardReading | None = None
        self._distress, self._cool = "", True  # reason of `MARGIN_C` ("": none); see `COOL_C`
        self._board: Worker[bool, BoardReading] = Worker("board", lambda _: board(), rest_s=BOARD_S)
        self._restart()

    def reconfigure(self, perception: PerceptionConfig) -> None:
        """Use another configuration with the same levels.

        Call it after the detector of that configuration runs.
        """
        before, self._perception = self._perception, perception
        self._state.budget_ms = perception.swap.budget_ms
        parts = ("detector", "isolation", "process")
        if any(getattr(before, part) != getattr(perception, part) for part in parts):
            self._restart()

    @property
    def level(self) -> int:
        """Current level; 0: nothing is dropped."""
        return self._state.level

    def step(self, now_ns: int) -> None:
        """Measure the load, and change the level if that is due. Called between two ticks."""
        self._measure()
        self._check_board(now_ns)
        if self._pending_change is not None:
            self._check_swap(self._pending_change, now_ns)
        elif self._is_blocked:
            self._restart_measurement(now_ns)
        elif now_ns - self._measured_from_ns >= SECOND_NS:
            sample = self._load_sample()
            self._restart_measurement(now_ns)
            change = self._state.update(sample, now_ns)
            if change is not None:
                self._begin_change(change, now_ns)

    def status(self) -> dict[str, object]:
        """Return the part of the status message."""
        state = "waiting" if self._is_blocked else "steady"
        return {
            "level": self.level,
            "levels": len(self._settings),
            "state": "stepping" if self._pending_change else state,
            "why": self._last_change,
            "distress": self._distress,
            "paused": sorted(self._paused_scorers(self.level)),
            "power_mode": None if self._reading is None else self._reading.power_mode,
            "steps": dict(self.steps),
        }

    def close(self) -> None:
        """Stop reading the board. Wait `BOARD_S` at most, since a sensor may hang."""
        self._board.close(timeout_s=BOARD_S)

    @property
    def _is_blocked(self) -> bool:
        """True if another swap runs, or if the current model is not that of the level."""
        wanted = self._model_on(self.level)
        is_running = wanted is None or self._detector_swap.running == wanted
        return not is_running or self._detector_swap.state not in ("idle", *FINAL_STATES)

    def _restart(self) -> None:
        """Restart at level 0, whose model runs."""
        self._state = DegradationLevels(len(self._settings), self._perception.swap.budget_ms)
        self._unfit_models.clear()
        self._pending_change = None
        self._pause_scorers(0)

    def _measure(self) -> None:
        """Add the detector's time for a new image."""
        stats = self._worker.stats
        if stats.done != self._n_detected:
            self._n_detected = stats.done
            self._detector_ms.append(stats.last_latency_ns * 1e-6)

    def _check_board(self, now_ns: int) -> None:
        """Take the newest reading of the board's sensors, and request the next."""
        if self._board.idle:
            self._board.submit(True)
        board = self._board.poll()
        if board is None:
            return
        before, self._reading = self._reading, board
        self._distress = throttling_reason(board, before, MARGIN_C)
        self._cool = not throttling_reason(board, before, MARGIN_C + COOL_C)
        if before is not None and board.power_mode != before.power_mode:
            self._state.reset_times()
            self._event(
                f"load shedding: the board's power mode changed from {before.power_mode} to "
                f"{board.power_mode}; load shedding measures again which level fits",
                now_ns,
            )

    def _load_sample(self) -> LoadSample:
        """Return the load since the measurement was restarted."""
        median_ms = median(self._detector_ms) if self._detector_ms else None
        state, detail = detector_health(self._worker)
        degraded = f"the detector is degraded: {detail}" if state == "degraded" else ""
        return LoadSample(median_ms, degraded or self._distress, self._cool)

    def _restart_measurement(self, now_ns: int) -> None:
        self._measured_from_ns = now_ns
        self._detector_ms.clear()

    def _begin_change(self, change: LevelChange, now_ns: int) -> None:
        """Report a change of the level, and start it; a swap of the detector takes some time."""
        down = change.level > self.level
        # The entry in which the two levels differ.
        paused = self._settings[max(change.level, self.level) - 1].pause
        wanted = self._model_on(change.level)
        action = f"model {wanted}"
        if paused is not None:
            action = f"pause {paused}" if down else f"resume {paused}"
        direction = f"{'down' if down else 'up'} to level {change.level} of {len(self._settings)}"
        self._last_change = f"{direction}: {action}: {change.why}"
        self._event(f"load shedding: {self._last_change}", now_ns)
        if wanted in (None, self._detector_swap.running):
            self._finish_change(change, now_ns)
            return
        try:
            self._detector_swap.request(wanted, True, now_ns)
        except SwapError as error:
            self._abort_change(change, str(error), now_ns)
        else:
            self._pending_change = change

    def _check_swap(self, change: LevelChange, now_ns: int) -> None:
        """Check the swap of the detector that a change of the level waits for."""
        swap = self._detector_swap.status()
        if swap["state"] not in FINAL_STATES:
            return
        if swap["state"] == "kept":
            self._finish_change(change, now_ns)
            return
        if change.level > self.level:
            self._unfit_models.add(str(swap["model"]))  # from now on `_model_on` ignores it
        self._abort_change(change, str(swap["detail"]), now_ns)

    def _finish_change(self, change: LevelChange, now_ns: int) -> None:
        self.steps["down" if change.level > self.level else "up"] += 1
        self._pending_change = None
        self._state.arrived(change.level, now_ns)
        self._pause_scorers(change.level)
        self._restart_measurement(now_ns)

    def _abort_change(self, change: LevelChange, why: str, now_ns: int) -> None:
        self._pending_change = None
        self._last_change = f"level {change.level} cannot be used: {why}"
        self._event(f"load shedding: {self._last_change}", now_ns)
        if self._model_on(change.level) == self._detector_swap.running:
            # Without that model, the level has the model that runs now: only its pause is left.
            self._finish_change(change, now_ns)
        else:
            self._state.change_failed(now_ns)
            self._restart_measurement(now_ns)

    def _model_on(self, level: int) -> str | None:
        """Return the model of a level: the last one named up to it that is not unfit.

        None if the detector has no model.
        """
        detector = self._perception.detector
        fit = [detector.model if detector.kind == "onnx" else None]
        named = (setting.model for setting in self._settings[:level] if setting.model)
        fit += [model for model in named if model not in self._unfit_models]
        return fit[-1]

    def _paused_scorers(self, level: int) -> frozenset[str]:
        return frozenset(setting.pause for setting in self._settings[:level] if setting.pause)

    def _pause_scorers(self, level: int) -> None:
        if self._scorers is not None:
            self._scorers.shed = self._paused_scorers(level)


def _check_model_is_here(name: str) -> None:
    """Raise if a model is not on this computer."""
    card = load_detector_card(name)
    if card.server is None and not card.is_here():
        raise ModelError(
            f"{card.path}: model {name} of perception.load_shedding.levels is not on this "
            f"computer; {install_hint(card)}"
        )
