"""Handlers of `edge run`, `edge demo`, `edge play` and `edge sim`."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
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
from edge.loop.runner import loop
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
    recorded = report is not None
    latch = StopLatch(stop_file(config.zenoh.prefix))
    ended = _serve(config, stop, once, what, reload, recorded=recorded, latch=latch)
    code = _conclude(ended, report)
    return code if once else os.EX_OK


def _prepare(config: Config, report: str | None) -> None:
    """Raise UserError if the configuration cannot be run, or the report cannot be written."""
    check(config)
    if report is not None:
        require_extra("lab")
        from edge.lab.report.page import prepare

        prepare(report)


def _serve(
    config: Config,
    stop: threading.Event,
    once: bool,
    what: MissionArguments,
    reload: ReloadRequest | None = None,
    stay: bool = False,
    playback: Playback | None = None,
    recorded: bool = False,
    latch: StopLatch | None = None,
) -> RunResult:
    """Run the service until `stop` is set, or as the arguments say; return the results of the run.

    The arguments of `run_service` are the same here. With `stay`, the live view stays open after
    the end of the mission or recording, until `stop` is set; the results are those at that end. A
    `playback` replaces the configured source. `recorded` collects the data of a report. Without
    `latch`, a stop of the robot ends with the run.
    """
    latch = latch or StopLatch()
    recorder, health = _recorder(config) if recorded else None, ServiceHealth(SystemdNotifier())
    live, metrics, trace_page = LiveView(config, health), Metrics(health), TracePage()
    sinks = [ConsoleSink(), *([] if recorder is None else [recorder]), live.sink]
    live.open(stop_requests(latch))  # a robot can be stopped before the service is ready
    pages = {**health.pages(), **metrics.pages(), **trace_page.pages(), **live.pages()}
    with (
        _serve_pages(pages, live.forms(), config.http) as url,
        open_service(
            config,
            sinks,
            *what,
            stop,
            health.starting,
            health.problems,
            None if playback is None else playback.open,
            latch,
            None if playback is None else playback.clock,
        ) as running,
    ):
        live.open({key: server.queue for key, server in running.servers.items()})
        if reload is not None:
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
        ended: RunResult | None = None

        def is_over() -> bool:
            return running.service.status.done if playback is None else playback.is_over

        def make_result() -> RunResult:
            result = running.service.result()
            return RunResult(
                result.status,
                result.latency(),
                result.snapshot().known_m2,
                tuple(result.instances()),
                None if recorder is None else recorder.record(result, running.source.counters),
            )

        def after_cycle() -> None:
            nonlocal ended
            health.beat(running)
            if not is_over():
                ended = None  # also if a new mission has begun
            elif stay and ended is None:
                ended = make_result()
                phase = running.service.status.phase
                outcome = f"mission {phase}" if playback is None else "recording played"
                log.info("%s; the live view stays open until Ctrl-C: %s", outcome, url)
            elif playback is not None and not stay:
                stop.set()

        loop(running, stop, once and not stay, after_cycle)
        health.stopping()
        return ended or make_result()


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
            stay = live is not None
            ended = _serve(config, stop, True, what, stay=stay, recorded=True)
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
    if live is not None:
        config = _with_live_view(config, live)
    _prepare(config, report)
    with Playback(file, config, rate, stop) as playback:
        for line in playback.describe_contents():
            print(line, flush=True)
        playback.check()
        stay = live is not None
        recorded = report is not None
        ended = _serve(config, stop, False, what, stay=stay, playback=playback, recorded=recorded)
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
        "http": config.http.model_copy(update={"port": None}),
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
