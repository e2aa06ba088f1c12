"""Health of the service, for the service manager (systemd) and for HTTP probes.

The thread that starts the service reports first, then the loop's thread after each cycle. If the
loop hangs, the watchdog signal stops, because no other thread sends it.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Literal, get_args

from edge.host.open_files import open_files_problem
from edge.host.service_manager import SystemdNotifier
from edge.host.web_server import GetRoutes, HttpResponse, json_response
from edge.loop.runner import RunningService
from edge.loop.source import missing_inputs
from edge.loop.status import detector_health
from edge.text import one_line

log = logging.getLogger("edge.loop.monitoring.service_health")

STEP_S = 300.0
"""Longest time between two progress reports of the start."""
HANGS_S = 10.0
"""The loop hangs if it has no cycle for this time. The detector hangs if it works at one image for
this time."""
PROBES = ("/healthz", "/readyz")
"""Pages whose HTTP status is public, but whose content needs the token."""
_CHECK_PERIOD_S = 1.0  # time between two searches for problems
_NO_OBSERVATIONS = "no usable observations"  # without the duration, which would change each second
_LOG_AFTER_S = 5.0  # sensors that start together with the service are running by then
_LOG_AGAIN_S = 10.0  # shortest time between two log lines about missing inputs

State = Literal["starting", "running", "reloading", "stopping"]
STATES: tuple[State, ...] = get_args(State)


class ServiceHealth:
    """State of the service, and the problems that make it not ready."""

    def __init__(
        self, manager: SystemdNotifier, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.state: State = "starting"
        self._manager, self._clock = manager, clock
        self._problems: tuple[str, ...] = ("starting",)
        self._sent_line = self._open_files_problem = ""
        self._last_beat_s = self._next_ping_s = self._next_check_s = self._ready_s = clock()
        # Stamp of the newest observation that was not refused, and the time when it came.
        self._stamp_ns, self._observed_s = 0, -math.inf
        # Number of images that the detector has finished, and the time of the last one.
        self._images, self._detected_s = 0, clock()
        self._logged, self._logged_s = "", -math.inf  # last logged line about missing inputs

    # -- for the threads that start, run and stop the service --------------------------------

    def starting(self, step: str) -> None:
        """Report that a step of the start has begun or continues; see `STEP_S`."""
        self._problems = (f"starting: {step}",)
        self._manager.starting(step, STEP_S)

    def ready(self) -> None:
        """Report that the loop begins."""
        self._last_beat_s = self._ready_s = self._clock()
        self._problems = (_NO_OBSERVATIONS,)
        self.state = "running"
        self._manager.ready()

    def beat(self, running: RunningService) -> None:
        """Report a loop cycle. The loop's thread calls this; it never waits."""
        self._last_beat_s = now_s = self._clock()
        if running.service.stamp_ns != self._stamp_ns:
            self._stamp_ns, self._observed_s = running.service.stamp_ns, now_s
        if self._manager.ping_s is not None and now_s >= self._next_ping_s:
            self._next_ping_s = now_s + self._manager.ping_s
            self._manager.alive()
        is_reloading = running.reloader is not None and running.reloader.busy
        if is_reloading != (self.state == "reloading"):
            self.state, self._next_check_s = "reloading" if is_reloading else "running", now_s
            if is_reloading:
                self._manager.reloading()
            else:
                self._manager.ready()
        if now_s >= self._next_check_s:
            self._next_check_s = now_s + _CHECK_PERIOD_S
            self._check(running, now_s)

    def stopping(self) -> None:
        self.state = "stopping"
        self._problems = ("stopping",)
        self._manager.stopping()

    def _check(self, running: RunningService, now_s: float) -> None:
        """Search for problems, and send the service manager a line of text if it changed."""
        stats = running.worker.stats
        images = stats.done + stats.failed
        if images != self._images or running.worker.idle:
            self._images, self._detected_s = images, now_s
        no_observation_s, at_one_image_s = now_s - self._observed_s, now_s - self._detected_s
        self._problems = tuple(_problems(running, no_observation_s, at_one_image_s))
        self._log_missing_inputs(now_s)
        if (files_problem := open_files_problem()) and files_problem != self._open_files_problem:
            log.error("%s: new files and connections fail until others are closed", files_problem)
        elif self._open_files_problem and not files_problem:
            log.info("files and connections can be opened again")
        self._open_files_problem = files_problem
        if files_problem:
            self._problems += (files_problem,)
        status = running.service.status
        activity = status.reason if status.phase == "idle" else status.instruction
        line = f"{status.phase}: {one_line(activity, 100)}"
        if self._problems:
            line = f"not ready: {'; '.join(self._problems)} ({line})"
        if running.reloader is not None and running.reloader.outcome:
            line = f"{line}; reload: {running.reloader.outcome}"
        if line != self._sent_line:
            self._sent_line = line
            self._manager.status(line)

    def _log_missing_inputs(self, now_s: float) -> None:
        """Log the missing inputs after a while without observations, and again if they change."""
        problem = next((why for why in self._problems if why.startswith(_NO_OBSERVATIONS)), "")
        if not problem:
            self._logged = ""
        elif (
            problem != self._logged
            and now_s - max(self._observed_s, self._ready_s) >= _LOG_AFTER_S
            and now_s - self._logged_s >= _LOG_AGAIN_S
        ):
            self._logged, self._logged_s = problem, now_s
            log.warning("%s", problem)

    # -- for any thread ------------------------------------------------------------------------

    @property
    def silent_s(self) -> float:
        """Time since the newest loop cycle, or since the start."""
        return self._clock() - self._last_beat_s

    @property
    def no_observation_s(self) -> float:
        """Time since the newest observation that was not refused; infinite before the first."""
        return self._clock() - self._observed_s

    def hangs(self) -> tuple[str, ...]:
        """Return the reasons to restart the service; empty while the loop runs."""
        silent_s = self.silent_s
        if self.state in ("running", "reloading") and silent_s > HANGS_S:
            return (f"the loop has hung for {silent_s:.0f} s",)
        return ()

    def problems(self) -> tuple[str, ...]:
        """Return the reasons why the service is not ready; empty if it is ready."""
        return self.hangs() or self._problems

    def pages(self) -> GetRoutes:
        """Return the pages `/healthz` (200 while the loop runs) and `/readyz` (200 while ready).

        Otherwise they return 503.
        """
        return {
            "/healthz": lambda: self._page(self.hangs()),
            "/readyz": lambda: self._page(self.problems()),
        }

    def _page(self, why: tuple[str, ...]) -> HttpResponse:
        status = HTTPStatus.SERVICE_UNAVAILABLE if why else HTTPStatus.OK
        return json_response({"ok": not why, "state": self.state, "why": why}, status)


def _problems(
    running: RunningService, no_observation_s: float, at_one_image_s: float
) -> Iterator[str]:
    """Yield the reasons why the running service is not ready."""
    service = running.service
    if running.latch.reason:
        yield f"stopped: {running.latch.reason}"
    if no_observation_s > service.plausibility.blind_s:
        why = service.error_boundary.call(
            "inputs", running.now_ns, lambda: missing_inputs(service.parts_status.inputs())
        )
        # Checks of the sensor data for which observations are refused, so that the robot stands.
        why = "; ".join(filter(None, (why, service.plausibility.why("stand"))))
        yield f"{_NO_OBSERVATIONS}: {why}" if why else _NO_OBSERVATIONS
    # Checks that only make the service not ready.
    if problem := service.plausibility.why("degrade"):
        yield problem
    if service.error_boundary.state != "ok":
        yield f"the loop is {service.error_boundary.state}: {service.error_boundary.last_error}"
    detector = detector_health(running.worker)
    if detector.state != "ok":
        yield f"the detector is {detector.state}: {one_line(detector.detail)}"
    elif at_one_image_s > HANGS_S:
        yield f"the detector has hung at one image for more than {HANGS_S:g} s"
