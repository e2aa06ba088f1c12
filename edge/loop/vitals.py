"""How the service is, for who watches over it: the service manager, and whoever asks over HTTP.

What it says comes from the thread that starts the service, then from the loop's, after each beat of
the loop: where the loop hangs, signs of life stay out, and nothing else gives them.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Literal, get_args

from edge.host.open_files import shortage
from edge.host.pages import Page, Pages, json_page
from edge.host.service_manager import ServiceManager
from edge.loop.runner import Running
from edge.loop.source import lacking
from edge.loop.status import detector_health
from edge.text import one_line

log = logging.getLogger("edge.loop.vitals")

STEP_S = 300.0
"""No step of the start takes longer without saying that it goes on."""
HANGS_S = 10.0
"""A loop without a beat for so long hangs, and so does a detector at one image."""
PROBES = ("/healthz", "/readyz")
"""Pages whose status is for everybody, and what they say for who knows the token."""
_LOOK_S = 1.0
_UNSEEN = "no usable observations"  # not for how long: that would be another line each second
_TELL_S = 5.0  # sensors that start together with the service have come by then
_TELL_AGAIN_S = 10.0

State = Literal["starting", "running", "reloading", "stopping"]
STATES: tuple[State, ...] = get_args(State)


class Vitals:
    """What the service is at, and what is amiss with it.

    Args:
        manager: is told of all that changes.
        clock: seconds.

    Attributes:
        state: what it is at.
    """

    def __init__(
        self, manager: ServiceManager, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.state: State = "starting"
        self._manager, self._clock = manager, clock
        self._amiss: tuple[str, ...] = ("starting",)
        self._said = self._short = ""
        self._beat_s = self._ping_s = self._look_s = self._ready_s = clock()
        self._stamp_ns, self._seen_s = 0, -math.inf
        self._images, self._detected_s = 0, clock()
        self._told, self._told_s = "", -math.inf  # of what is missing, to the log

    # -- for those who start, run and stop the service ---------------------------------------

    def starting(self, what: str) -> None:
        """A step of the start has begun, or goes on; see `STEP_S`."""
        self._amiss = (f"starting: {what}",)
        self._manager.starting(what, STEP_S)

    def ready(self) -> None:
        """The loop begins."""
        self._beat_s = self._ready_s = self._clock()
        self._amiss = (_UNSEEN,)
        self.state = "running"
        self._manager.ready()

    def beat(self, running: Running) -> None:
        """The loop goes on; called by its thread, and never waits."""
        self._beat_s = now_s = self._clock()
        if running.service.stamp_ns != self._stamp_ns:
            self._stamp_ns, self._seen_s = running.service.stamp_ns, now_s
        if self._manager.ping_s is not None and now_s >= self._ping_s:
            self._ping_s = now_s + self._manager.ping_s
            self._manager.alive()
        reloads = running.reloader is not None and running.reloader.busy
        if reloads != (self.state == "reloading"):
            self.state, self._look_s = "reloading" if reloads else "running", now_s
            (self._manager.reloading if reloads else self._manager.ready)()
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            self._look(running, now_s)

    def stopping(self) -> None:
        self.state = "stopping"
        self._amiss = ("stopping",)
        self._manager.stopping()

    def _look(self, running: Running, now_s: float) -> None:
        stats = running.worker.stats
        images = stats.done + stats.failed
        if images != self._images or running.worker.idle:
            self._images, self._detected_s = images, now_s
        unseen_s, at_one_image_s = now_s - self._seen_s, now_s - self._detected_s
        self._amiss = tuple(_amiss(running, unseen_s, at_one_image_s))
        self._tell_unseen(now_s)
        if (short := shortage()) and short != self._short:
            log.error("%s: what needs one fails until others are closed", short)
        elif self._short and not short:
            log.info("files and connections can be opened again")
        self._short = short
        self._amiss += (short,) * bool(short)
        status = running.service.status
        doing = status.reason if status.phase == "idle" else status.instruction
        said = f"{status.phase}: {one_line(doing, 100)}"
        if self._amiss:
            said = f"not ready: {'; '.join(self._amiss)} ({said})"
        if running.reloader is not None and running.reloader.outcome:
            said = f"{said}; reload: {running.reloader.outcome}"
        if said != self._said:
            self._said = said
            self._manager.status(said)

    def _tell_unseen(self, now_s: float) -> None:
        """Log what is missing when nothing is seen for a while, and when something else is."""
        unseen = next((why for why in self._amiss if why.startswith(_UNSEEN)), "")
        if not unseen:
            self._told = ""
        elif (
            unseen != self._told
            and now_s - max(self._seen_s, self._ready_s) >= _TELL_S
            and now_s - self._told_s >= _TELL_AGAIN_S
        ):
            self._told, self._told_s = unseen, now_s
            log.warning("%s", unseen)

    # -- for any thread ------------------------------------------------------------------------

    @property
    def silent_s(self) -> float:
        """How long ago the loop's newest beat was, or the start."""
        return self._clock() - self._beat_s

    @property
    def unseen_s(self) -> float:
        """How long ago something new was seen; infinite before anything was."""
        return self._clock() - self._seen_s

    def hangs(self) -> tuple[str, ...]:
        """Why it should be started again; nothing while it lives."""
        silent_s = self.silent_s
        if self.state in ("running", "reloading") and silent_s > HANGS_S:
            return (f"the loop has hung for {silent_s:.0f} s",)
        return ()

    def amiss(self) -> tuple[str, ...]:
        """Why the robot cannot count on it now; nothing while it can."""
        return self.hangs() or self._amiss

    def pages(self) -> Pages:
        """`/healthz` is 200 while it lives, `/readyz` while nothing is amiss; else 503."""
        return {
            "/healthz": lambda: self._page(self.hangs()),
            "/readyz": lambda: self._page(self.amiss()),
        }

    def _page(self, why: tuple[str, ...]) -> Page:
        status = HTTPStatus.SERVICE_UNAVAILABLE if why else HTTPStatus.OK
        return json_page({"ok": not why, "state": self.state, "why": why}, status)


def _amiss(running: Running, unseen_s: float, at_one_image_s: float) -> Iterator[str]:
    service = running.service
    if unseen_s > service.blind_s:
        why = service.faults.attempt("inputs", running.now_ns, lambda: lacking(service.inputs()))
        why = "; ".join(filter(None, (why, service.plausibility.why("stand"))))
        yield f"{_UNSEEN}: {why}" if why else _UNSEEN
    if doubt := service.plausibility.why("degrade"):
        yield doubt
    if service.faults.state != "ok":
        yield f"the loop is {service.faults.state}: {service.faults.last_error}"
    detector = detector_health(running.worker)
    if detector.state != "ok":
        yield f"the detector is {detector.state}: {one_line(detector.detail)}"
    elif at_one_image_s > HANGS_S:
        yield "the detector hangs at an image"
