"""Reload of the configuration in the running service: prepared in the background, then applied.

It is all or nothing. If a changed key cannot be changed at run time, or a part of the new
configuration cannot be made, the service keeps its configuration and reports the reason.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass

from edge.config import Config, DetectorOnnx, PerceptionConfig, Section
from edge.errors import UserError
from edge.host.interruptible import start_detached_thread
from edge.loop.service import Service
from edge.loop.warmup import warm_policy
from edge.perception.masks.ground import GroundClassifier, make_ground_classifier
from edge.perception.scoring.similarity import is_running_detector, similarity_card
from edge.perception.swap.base import FINAL_STATES
from edge.perception.swap.detector import DetectorSwap
from edge.policies import make_policy
from edge.policies.base import Policy
from edge.text import one_line

log = logging.getLogger("edge.loop.reload")

_DETECTOR = ("perception.detector", "perception.isolation", "perception.process")
LIVE = (
    "policy",
    *_DETECTOR,
    "perception.swap",
    "perception.tau_det",
    "perception.back_projection_min_points",
    "perception.back_projection_max_range_m",
    "perception.merge_m",
    "perception.min_hits",
    "perception.confirm_score",
    "perception.confirm_scores",
    "perception.confirm_range_m",
    "perception.confirm_hits",
    "perception.confirm_mean",
    "perception.confirm_lead",
    "mission.search_limit_s",
    "mission.time_limit_s",
    "mission.path_limit_m",
    "mission.reach_m",
    "mission.verify_s",
    "mission.discard_s",
    "mission.probable",
    "tasks",
)
"""Keys that can change while the service runs, with all keys below them."""
# Advice for keys that cannot change while the service runs.
_ADVICE = {
    "mission.target": "give the running service another mission with `edge mission new`",
    "mission.instruction": "give the running service another mission with `edge mission new`",
}
_MOST_CHARS = 600  # of the result of a reload
OUTCOMES = ("switched", "unchanged", "refused")
"""Results of a reload."""


class ReloadError(UserError):
    """A configuration that cannot be applied. The message is one line."""


@dataclass(frozen=True)
class _PreparedConfig:
    """A prepared configuration that can be applied.

    Attributes:
        changed: Keys that differ from the current configuration.
        policy: New policy; None: keep the current one.
        ground: What names kinds of ground, of `config`.
        running: Name of the detector's model when this was prepared.
        model: Name of the model to swap in; None: keep the current one.
    """

    config: Config
    changed: tuple[str, ...]
    policy: Policy | None
    ground: GroundClassifier | None
    running: str
    model: str | None


class Reloader:
    """Reloads of the configuration of a service, one after another.

    The loop's thread calls `step`. A new detector first goes through the swap's trial and
    probation. The rest is applied when the swap is final.

    Args:
        reread: Reads the configuration again, in the same way as at the start.
        requested: Event that any thread sets to request a reload.

    Attributes:
        outcome: Result of the newest reload, one line; "" before the first.
        outcomes: Number of reloads by result (`OUTCOMES`).
    """

    def __init__(
        self, service: Service, reread: Callable[[], Config], requested: threading.Event
    ) -> None:
        self.outcome = ""
        self.outcomes = dict.fromkeys(OUTCOMES, 0)
        self._service, self._reread, self._requested = service, reread, requested
        self._preparing: Future[_PreparedConfig] | None = None
        self._swapping: _PreparedConfig | None = None

    @property
    def busy(self) -> bool:
        """True while a reload is running."""
        return self._preparing is not None or self._swapping is not None

    def step(self, now_ns: int) -> None:
        """Do the next step of a reload, between two ticks. Never wait.

        The steps: start the preparation, apply it or start the swap, wait until the swap is final.
        """
        try:
            if self._swapping is not None:
                self._wait_for_model(self._swapping, now_ns)
            elif self._preparing is not None:
                self._apply_when_prepared(self._preparing, now_ns)
            elif self._requested.is_set():
                self._begin()
        except Exception as error:
            self._preparing = self._swapping = None
            known = isinstance(error, UserError)
            text = str(error) if known else f"{type(error).__name__}: {error}"
            why = "; ".join(text.splitlines())
            log.debug("reload", exc_info=True)
            self._report("refused", f"refused, nothing has changed: {why}", now_ns)

    def _begin(self) -> None:
        """Start to read and prepare the configuration, on a thread."""
        self._requested.clear()
        log.info("reload: reading the configuration")
        present, running = self._service.config, self._service.detector_swap.running
        ground = self._service.ground
        preparing: Future[_PreparedConfig] = Future()
        self._preparing = preparing

        def prepare() -> None:
            try:
                preparing.set_result(_prepare(present, self._reread(), running, ground))
            except Exception as error:
                preparing.set_exception(error)
            # A plugin that raises SystemExit must not end the process.
            except BaseException as error:
                preparing.set_exception(ReloadError(f"it raised {type(error).__name__}"))

        start_detached_thread("reload", prepare)

    def _apply_when_prepared(self, preparing: Future[_PreparedConfig], now_ns: int) -> None:
        if not preparing.done():
            return
        self._preparing = None
        ready, swapper = preparing.result(), self._service.detector_swap
        if any(_is_below(key, _DETECTOR) for key in ready.changed):
            _check_no_swap(swapper, ready.running)
        if not ready.changed:
            self._report("unchanged", "nothing has changed", now_ns)
        elif ready.model is None:
            self._apply_now(ready, now_ns)
        else:
            swapper.request(ready.model, False, now_ns, ready.config.perception)
            self._swapping = ready

    def _wait_for_model(self, ready: _PreparedConfig, now_ns: int) -> None:
        swap = self._service.detector_swap.status()
        if swap["state"] not in FINAL_STATES:
            return
        self._swapping = None
        if swap["state"] != "kept":
            raise ReloadError(
                f"perception.detector: the new model was {swap['state']}: {swap['detail']}"
            )
        self._apply_now(ready, now_ns)

    def _apply_now(self, ready: _PreparedConfig, now_ns: int) -> None:
        service = self._service
        policy = service.perception.policy if ready.policy is None else ready.policy
        service.reconfigure(ready.config, policy, ready.ground)
        self._report("switched", f"switched: {', '.join(ready.changed)}", now_ns)

    def _report(self, result: str, outcome: str, now_ns: int) -> None:
        self.outcomes[result] += 1
        self.outcome = one_line(outcome, _MOST_CHARS)
        level = logging.WARNING if result == "refused" else logging.INFO
        self._service.event(f"reload: {self.outcome}", now_ns, level)


def _prepare(
    present: Config, new: Config, running: str, ground: GroundClassifier | None
) -> _PreparedConfig:
    """Compare the configurations and make the parts that changed.

    Raises:
        ReloadError: A changed key needs a restart.
        UserError: The policy, or the model of `tasks.ground`, cannot be made.
    """
    changed = tuple(key for key in differing_keys(present, new) if key != "path")
    if fixed := [key for key in changed if not _is_below(key, LIVE)]:
        raise ReloadError("; ".join(f"{key}: {_advice(key)}" for key in fixed))
    policy = None
    if new.policy != present.policy:
        warm_policy(new)
        policy = make_policy(new.policy, new.origin("policy"))
    if new.tasks.ground != present.tasks.ground:
        ground = make_ground_classifier(new.tasks)
    model = _model_to_swap(present.perception, new.perception, running)
    return _PreparedConfig(new, changed, policy, ground, running, model)


def _check_no_swap(swapper: DetectorSwap, running: str) -> None:
    """Raise ReloadError if the model changed, or is changing, since the reload was prepared."""
    swap = swapper.status()
    if swap["state"] not in ("idle", *FINAL_STATES):
        raise ReloadError(
            f"perception.detector: {swap['model']} is still {swap['state']}; "
            "reload again after this swap"
        )
    if swapper.running != running:
        raise ReloadError(
            f"perception.detector: {swapper.running} was swapped in during the reload; reload again"
        )


def _model_to_swap(present: PerceptionConfig, new: PerceptionConfig, running: str) -> str | None:
    """Return the model to swap in, or None if the current detector fits the configuration."""
    changed = [
        key for key in differing_keys(present, new, "perception.") if _is_below(key, _DETECTOR)
    ]
    if not changed:
        return None
    if not isinstance(new.detector, DetectorOnnx):
        raise ReloadError(f"{changed[0]}: {_advice(changed[0])}")
    card = similarity_card(new)
    if card is not None and is_running_detector(card, present) != is_running_detector(card, new):
        raise ReloadError(
            f"perception.detector.model: {card.name} of perception.similarity uses the image "
            "features of the old detector or of the new one: "
            f"{_advice('perception.detector.model')}"
        )
    only_the_name = changed == ["perception.detector.model"]
    return None if only_the_name and new.detector.model == running else new.detector.model


def differing_keys(one: Section, other: Section, prefix: str = "") -> Iterator[str]:
    """Yield the dotted keys in which two sections of one class differ.

    A section of another kind, or a different list, is one key.
    """
    for name in type(one).model_fields:
        a, b = getattr(one, name), getattr(other, name)
        if isinstance(a, Section) and type(a) is type(b):
            yield from differing_keys(a, b, f"{prefix}{name}.")
        elif a != b:
            yield f"{prefix}{name}"


def _is_below(key: str, keys: tuple[str, ...]) -> bool:
    """Return True if the key is one of these keys, or below one of them."""
    return any(key == one or key.startswith(f"{one}.") for one in keys)


def _advice(key: str) -> str:
    return _ADVICE.get(key, "restart the service to change it")
