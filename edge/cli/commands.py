"""What `edge run`, `edge demo` and `edge sim` do."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from edge.cli.console import ConsoleSink
from edge.config import Config, Http
from edge.errors import FAILED, Stopped
from edge.host.credentials import read_token
from edge.host.pages import Forms, Pages, serve
from edge.host.ports import free_port
from edge.host.service_manager import ServiceManager
from edge.launch import children, on_a_free_port, open_service
from edge.live.view import PUBLIC, LiveView
from edge.loop.metrics import Metrics
from edge.loop.reload import Reloader
from edge.loop.runner import loop
from edge.loop.vitals import PROBES, Vitals
from edge.recording.trace import TracePage
from edge.report.record import RunRecord
from edge.report.recorder import Recorder
from edge.text import one_line
from edge.types import MissionStatus

log = logging.getLogger("edge")


@dataclass(frozen=True)
class Reload:
    """How the service's configuration is reloaded; see `edge.loop.reload.Reloader`."""

    reread: Callable[[], Config]
    asked: threading.Event


def run_service(
    config: Config,
    stop: threading.Event,
    once: bool,
    report: str | None,
    asked: str | None = None,
    formula: str | None = None,
    task: str | None = None,
    reload: Reload | None = None,
) -> int:
    """Run the service; the exit code, see `edge.errors`.

    What is told to stop has done what it was to do, whatever became of its last mission; with
    `once` that is the outcome.

    Args:
        asked, formula, task: the mission as given on the command line; see `open_service`.
        reload: None: the configuration stays.

    Raises:
        UserError: no report can be written there (said before the run).
        Stopped: `stop` was set before the service was ready.
    """
    _prepare(report)
    code = _conclude(_serve(config, stop, once, asked, formula, task, reload), report)
    return code if once else os.EX_OK


def _prepare(report: str | None) -> None:
    if report is not None:
        from edge.report.page import prepare

        prepare(report)


def _serve(
    config: Config,
    stop: threading.Event,
    once: bool,
    asked: str | None,
    formula: str | None,
    task: str | None,
    reload: Reload | None = None,
) -> RunRecord:
    recorder, vitals = Recorder(config), Vitals(ServiceManager())
    live, metrics, traced = LiveView(config, vitals), Metrics(vitals), TracePage()
    sinks = [ConsoleSink(), recorder, live.sink]
    pages = {**vitals.pages(), **metrics.pages(), **traced.pages(), **live.pages()}
    with (
        _served(pages, live.forms(), config.http),
        open_service(
            config, sinks, asked, formula, task, stop, vitals.starting, vitals.amiss
        ) as running,
    ):
        live.open({key: server.queue for key, server in running.servers.items()})
        if reload is not None:
            running.reloader = Reloader(running.service, reload.reread, reload.asked)
        metrics.watch(running, running.sinks)
        traced.spans = running.service.latency.spans
        mission = running.service.mission
        doing = mission.reason if mission.idle else one_line(mission.brief.translation.instruction)
        log.info("ready: %s, on %s", doing, config.zenoh.address)
        vitals.ready()
        loop(running, stop, once, partial(vitals.beat, running))
        vitals.stopping()
        return recorder.record(running.service.result(), running.source.counters)


@contextmanager
def _served(pages: Pages, forms: Forms, http: Http) -> Iterator[None]:
    """The pages over HTTP, as is configured; see `edge.host.pages.serve`."""
    if http.port is None:
        yield
        return
    token = None if http.token_file is None else read_token("http.token_file", http.token_file)
    with serve(pages, http.host, http.port, token, PROBES, forms, PUBLIC) as port:
        host = f"[{http.host}]" if ":" in http.host else http.host
        log.info("live view: http://%s:%s/", one_line(host), port)
        yield


def _conclude(record: RunRecord, report: str | None) -> int:
    """Print how it went, write the report; the exit code."""
    print(record.latency.table())
    print(summary(record.mission))
    if report is not None:
        from edge.report.page import write_report

        for path in filter(None, write_report(record, Path(report))):
            print(path)
    return FAILED if record.mission.phase == "failed" else os.EX_OK


def summary(status: MissionStatus) -> str:
    """The outcome in one line."""
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
    asked: str | None = None,
    formula: str | None = None,
    task: str | None = None,
    live: int | None = None,
) -> int:
    """Simulated robot, reference controller and service on this machine; ends with the mission.

    Args:
        asked, formula, task: see `run_service`.
        live: port for the live view; 0: `http.port`, or a free one; None: only `http.port`.
    """
    config = on_a_free_port(config)
    if live is not None:
        http = config.http.model_copy(update={"port": live or config.http.port or free_port()})
        config = config.model_copy(update={"http": http})
    _prepare(report)
    record = None
    try:
        started = children(config, stop, ("sim", "--no-motion"), ("motion",))
        with started, suppress(Stopped):  # `started` says it when a child that ended was the cause
            record = _serve(config, stop, True, asked, formula, task)
    finally:  # a child's failure must not cost the report
        code = 0 if record is None else _conclude(record, report)
    return code


def run_simulator(config: Config, stop: threading.Event, motion: bool) -> int:
    """The simulated robot in this process, the reference controller in another."""
    from edge.sim.process import main as run_sim

    with children(config, stop, *([("motion",)] if motion else [])):
        return run_sim(config, stop)
