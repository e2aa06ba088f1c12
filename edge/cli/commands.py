"""Handlers of `edge run`, `edge demo`, `edge play` and `edge sim`."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from edge.bus.stop import stop_requests
from edge.cli.console import ConsoleSink
from edge.cli.options import require_extra
from edge.cli.preflight import check
from edge.config import Config, HttpConfig
from edge.errors import FAILED, Stopped
from edge.host.credentials import read_token
from edge.host.ports import free_port, is_free
from edge.host.service_manager import SystemdNotifier
from edge.host.stop_latch import StopLatch, stop_file
from edge.host.web_server import GetRoutes, PostRoutes, serve
from edge.launch import child_processes, open_service, with_free_port
from edge.live.view import PUBLIC, LiveView
from edge.loop.latency import LatencyReport
from edge.loop.monitoring.metrics import Metrics
from edge.loop.monitoring.service_health import PROBES, ServiceHealth
from edge.loop.reload import Reloader
from edge.loop.runner import RunningService, loop
from edge.recording.trace import TracePage
from edge.sources.played import Playback
from edge.text import one_line
from edge.types import Instance, MissionStatus

if TYPE_CHECKING:
    from edge.lab.report.record import RunRecord
    from edge.lab.report.recorder import ReportRecorder

log = logging.getLogger("edge")

_NO_LIMIT = 1e6
"""A limit of time in s, or of path in m, that no recording reaches."""
_MAX_PRINTED_OBJECTS = 20
MissionArguments = tuple[str | None, str | None, str | None]
"""A mission of the command line: (instruction, formula, task); see `edge.launch.open_service`."""
NO_MISSION: MissionArguments = (None, None, None)
LIVE_PORT = 7480
"""Default port of the live view: fixed, so that an open browser tab works for the next run."""


@dataclass(frozen=True, eq=False)
class RunResult:
    """Results of a run that has ended.

    Attributes:
        mission: final state of the mission.
        latency: times of the stages.
        map_m2: known area of the map.
        instances: objects that were found.
        record: data for a report; None if no report was asked for.
    """

    mission: MissionStatus
    latency: LatencyReport
    map_m2: float
    instances: tuple[Instance, ...]
    record: RunRecord | None


@dataclass(frozen=True)
class ReloadRequest:
    """A way to reload the service's configuration; see `edge.loop.reload.Reloader`.

    Attributes:
        reread: reads the configuration again.
        requested: set when a reload is requested.
    """

    reread: Callable[[], Config]
    requested: threading.Event


@dataclass(frozen=True)
class _Options:
    """Options of a run.

    Attributes:
        mission: Mission of the command line.
        once: The run ends with the mission.
        stay: The live view stays open after the end of the mission or recording, until the run is
            stopped. The results are those at that end.
        recorded: Collect the data of a report.
        reload: A way to reload the configuration; None: it is never reloaded.
        playback: Recording that replaces the configured source.
        latch: The stop of the robot; by default it ends with the run.
    """

    mission: MissionArguments = NO_MISSION
    once: bool = False
    stay: bool = False
    recorded: bool = False
    reload: ReloadRequest | None = None
    playback: Playback | None = None
    latch: StopLatch = field(default_factory=StopLatch)


def run_service(
    config: Config,
    stop: threading.Event,
    once: bool,
    report: str | None,
    what: MissionArguments = NO_MISSION,
    reload: ReloadRequest | None = None,
) -> int:
    """Run the service until `stop` is set, and return the exit code (`edge.errors`).

    A service that is stopped returns 0, even if its last mission failed. With `once`, it ends with
    the mission, and the exit code is that of the mission. `report` is a folder, `what` the mission
    of the command line. Without `reload`, the configuration is never reloaded.

    Raises:
        UserError: the report cannot be written, or something that the configuration names is
            missing. Both are checked before the run.
        Stopped: `stop` was set before the service was ready.
    """
    _prepare(config, report)
    latch = StopLatch(stop_file(config.zenoh.prefix))
    options = _Options(what, once, recorded=report is not None, reload=reload, latch=latch)
    code = _conclude(_serve(config, stop, options), report)
    return code if once else os.EX_OK


def _prepare(config: Config, report: str | None) -> None:
    """Raise UserError if the configuration cannot be run, or the report cannot be written."""
    check(config)
    if report is not None:
        require_extra("lab")
        from edge.lab.report.page import prepare

        prepare(report)


def _serve(config: Config, stop: threading.Event, options: _Options) -> RunResult:
    """Run the service until `stop` is set, or as the options say; return the results of the run."""
    recorder = _recorder(config) if options.recorded else None
    health = ServiceHealth(SystemdNotifier())
    live, metrics, trace_page = LiveView(config, health), Metrics(health), TracePage()
    sinks = [ConsoleSink(), *([] if recorder is None else [recorder]), live.sink]
    live.open(stop_requests(options.latch))  # a robot can be stopped before the service is ready
    pages = {**health.pages(), **metrics.pages(), **trace_page.pages(), **live.pages()}
    playback = options.playback
    with (
        _serve_pages(pages, live.forms(), config.http) as url,
        open_service(
            config,
            sinks,
            *options.mission,
            stop,
            health.starting,
            health.problems,
            None if playback is None else playback.open,
            options.latch,
            None if playback is None else playback.clock,
        ) as running,
    ):
        live.open({key: server.queue for key, server in running.servers.items()})
        if (reload := options.reload) is not None:
            running.reloader = Reloader(running.service, reload.reread, reload.requested)
        metrics.add_service(running, running.sinks)
        trace_page.spans = running.service.latency.spans
        mission = running.service.mission
        doing = (
            mission.reason
            if mission.ended == "idle"
            else one_line(mission.spec.translation.instruction)
        )
        log.info("ready: %s; Zenoh endpoint %s", doing, config.zenoh.address)
        health.ready()
        run = _Run(running, options, stop, health, recorder, url)
        loop(running, stop, options.once and not options.stay, run.after_cycle)
        health.stopping()
        return run.ended or run.result()


class _Run:
    """A run of the loop.

    Attributes:
        ended: Results at the end of the mission or recording, if the live view stays open after it.
    """

    def __init__(
        self,
        running: RunningService,
        options: _Options,
        stop: threading.Event,
        health: ServiceHealth,
        recorder: ReportRecorder | None,
        url: str | None,
    ) -> None:
        self._running, self._options, self._stop = running, options, stop
        self._health, self._recorder, self._url = health, recorder, url
        self.ended: RunResult | None = None

    @property
    def is_over(self) -> bool:
        """True if the recording was played; without a recording, if the mission has ended."""
        playback = self._options.playback
        return self._running.service.status.done if playback is None else playback.is_over

    def result(self) -> RunResult:
        """Return the results up to now."""
        result, recorder = self._running.service.result(), self._recorder
        return RunResult(
            result.status,
            result.latency(),
            result.snapshot().known_m2,
            tuple(result.instances()),
            None if recorder is None else recorder.record(result, self._running.source.counters),
        )

    def after_cycle(self) -> None:
        """Report that the loop runs. At the end, keep the results, or stop a recording's run."""
        self._health.beat(self._running)
        playback, stay = self._options.playback, self._options.stay
        if not self.is_over:
            self.ended = None  # also if a new mission has begun
        elif stay and self.ended is None:
            self.ended = self.result()
            phase = self._running.service.status.phase
            outcome = f"mission {phase}" if playback is None else "recording played"
            log.info("%s; the live view stays open until Ctrl-C: %s", outcome, self._url)
        elif playback is not None and not stay:
            self._stop.set()


@contextmanager
def _serve_pages(pages: GetRoutes, forms: PostRoutes, http: HttpConfig) -> Iterator[str | None]:
    """Serve the web pages as configured, in this block; yield their URL, or None without a port."""
    if http.port is None:
        yield None
        return
    token = None if http.token_file is None else read_token("http.token_file", http.token_file)
    with serve(pages, http.host, http.port, token, PROBES, forms, PUBLIC) as port:
        host = f"[{http.host}]" if ":" in http.host else http.host
        url = f"http://{one_line(host)}:{port}/"
        log.info("live view: %s", url)
        yield url


def _recorder(config: Config) -> ReportRecorder:
    from edge.lab.report.recorder import ReportRecorder

    return ReportRecorder(config)


def _conclude(ended: RunResult, report: str | None) -> int:
    """Print the results, write the report, and return the exit code."""
    print(ended.latency.table())
    print(summary(ended.mission))
    if report is not None and ended.record is not None:
        from edge.lab.report.page import write_report

        for path in filter(None, write_report(ended.record, Path(report))):
            print(path)
    return FAILED if ended.mission.phase == "failed" else os.EX_OK


def summary(status: MissionStatus) -> str:
    """Return the outcome of a mission in one line."""
    phase = status.phase if status.done else f"stopped while {status.phase}"
    reason = f" ({status.reason})" if status.reason else ""
    return (
        f"{phase}: {status.instruction}{reason}, {status.elapsed_s:.1f} s, "
        f"{status.path_m:.1f} m driven"
    )


def run_demo(
    config: Config,
    stop: threading.Event,
    report: str,
    what: MissionArguments = NO_MISSION,
    live: int | None = None,
) -> int:
    """Run simulated robot, reference controller and service on this machine.

    The run ends with the mission; with a live view it ends when `stop` is set. `live` is the port
    of the live view. 0: `http.port`, else `LIVE_PORT`, else a free port. None: only `http.port`.
    """
    config = with_free_port(config)
    if live is not None:
        config = _with_live_view(config, live)
    _prepare(config, report)
    ended = None
    try:
        started = child_processes(config, stop, ("sim", "--no-motion"), ("sim", "--motion-only"))
        with started, suppress(Stopped):  # if a child ended, `started` raises the reason
            options = _Options(what, once=True, stay=live is not None, recorded=True)
            ended = _serve(config, stop, options)
    finally:  # write the report even if a child process failed
        code = 0 if ended is None else _conclude(ended, report)
    return code


def run_play(
    config: Config,
    file: Path,
    stop: threading.Event,
    rate: float | None,
    report: str | None,
    live: int | None = None,
    what: MissionArguments = NO_MISSION,
) -> int:
    """Play a recording of any robot into the service; print its content and the results.

    Goals are chosen and shown, but nothing is published and nothing drives. `rate` is a multiple of
    real time; None: as fast as possible, without drops. `live` is as in `run_demo`, but None means
    no live view.

    Raises:
        UserError: see `run_service`; or the recording cannot be read, or gives no observation.
    """
    config = _config_for_recording(with_free_port(config), lockstep=rate is None)
    if live is None:
        config = config.model_copy(update={"http": config.http.model_copy(update={"port": None})})
    else:
        config = _with_live_view(config, live)
    _prepare(config, report)
    with Playback(file, config, rate, stop) as playback:
        for line in playback.describe_contents():
            print(line, flush=True)
        playback.check()
        stay, recorded = live is not None, report is not None
        options = _Options(what, stay=stay, recorded=recorded, playback=playback)
        ended = _serve(config, stop, options)
        lines = [*playback.describe_outcome(), *_map_lines(ended)]
    _conclude(ended, report)
    print("\n".join(lines))
    return os.EX_OK


def _config_for_recording(config: Config, lockstep: bool) -> Config:
    """Return the configuration for a recording: no limits of time or path, no sinks.

    The recorded robot does not follow our goals, so it must not count as stuck. The checkpoint of
    the service is neither read nor written.
    """
    mission = {
        "time_limit_s": _NO_LIMIT, "path_limit_m": _NO_LIMIT, "stuck_s": _NO_LIMIT,
        "search_limit_s": None, "checkpoint": None, "on_request": False,
    }  # fmt: skip
    update = {
        "mission": config.mission.model_copy(update=mission),
        "loop": config.loop.model_copy(update={"lockstep": lockstep}),
        "source": config.source.model_copy(update={"kind": "zenoh", "options": {}}),
        "sinks": (),
    }
    return config.model_copy(update=update)


def _map_lines(ended: RunResult) -> Iterator[str]:
    """Yield lines about the map and the objects that were found."""
    yield f"map: {ended.map_m2:.0f} m2; driven: {ended.mission.path_m:.1f} m"
    for instance in ended.instances[:_MAX_PRINTED_OBJECTS]:
        x_m, y_m, z_m = instance.center_m
        yield (
            f"object: {one_line(instance.label)} at ({x_m:.2f}, {y_m:.2f}, {z_m:.2f}) m, "
            f"{instance.hits} hits, score {instance.score:.2f}"
        )
    left = len(ended.instances) - _MAX_PRINTED_OBJECTS
    yield f"{left} more objects" if left > 0 else f"{len(ended.instances)} objects"


def _with_live_view(config: Config, live: int) -> Config:
    port = live or config.http.port or _live_port(config.http.host)
    http = config.http.model_copy(update={"port": port})
    return config.model_copy(update={"http": http})


def _live_port(host: str) -> int:
    if is_free(host, LIVE_PORT):
        return LIVE_PORT
    port = free_port()
    log.warning("live view: port %d is in use, so the page is served on port %d", LIVE_PORT, port)
    return port


def run_simulator(config: Config, stop: threading.Event, motion: bool) -> int:
    """Run the simulated robot in this process, and the reference controller in another."""
    from edge.lab.sim.process import main as run_sim

    with child_processes(config, stop, *([("sim", "--motion-only")] if motion else [])):
        return run_sim(config, stop)
