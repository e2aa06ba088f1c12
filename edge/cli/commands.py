"""What `edge run`, `edge demo` and `edge sim` do."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from edge.cli.console import ConsoleSink
from edge.config import Config, Http
from edge.errors import FAILED, Stopped
from edge.host.credentials import read_token
from edge.host.pages import Pages, serve
from edge.host.service_manager import ServiceManager
from edge.launch import children, on_a_free_port, open_service
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
    reload: Reload | None = None,
) -> int:
    """Run the service; the exit code, see `edge.errors`.

    What is told to stop has done what it was to do, whatever became of its last mission; with
    `once` that is the outcome.

    Args:
        asked, formula: the mission as given on the command line; see `open_service`.
        reload: None: the configuration stays.

    Raises:
        UserError: no report can be written there (said before the run).
        Stopped: `stop` was set before the service was ready.
    """
    _prepare(report)
    code = _conclude(_serve(config, stop, once, asked, formula, reload), report)
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
    reload: Reload | None = None,
) -> RunRecord:
    recorder, vitals, traced = Recorder(config), Vitals(ServiceManager()), TracePage()
    sinks = [ConsoleSink(), recorder]
    with (
        _served({**vitals.pages(), **traced.pages()}, config.http),
        open_service(config, sinks, asked, formula, stop, vitals.starting) as running,
    ):
        if reload is not None:
            running.reloader = Reloader(running.service, reload.reread, reload.asked)
        instruction = running.service.mission.brief.translation.instruction
        traced.spans = running.service.latency.spans
        log.info("ready: %s, on %s", one_line(instruction), config.zenoh.address)
        vitals.ready()
        loop(running, stop, once, partial(vitals.beat, running))
        vitals.stopping()
        return recorder.record(running.service.result(), running.source.counters)


def _served(pages: Pages, http: Http) -> AbstractContextManager[int | None]:
    """The pages over HTTP, as is configured; see `edge.host.pages.serve`."""
    unasked = http.port is None or http.token_file is None
    token = None if unasked else read_token("http.token_file", http.token_file)
    return serve(pages, http.host, http.port, token, PROBES)


def _conclude(record: RunRecord, report: str | None) -> int:
    """Print how it went, write the report; the exit code."""
    print(record.latency.table())
    print(summary(record.mission))
    if report is not None:
        from edge.report.page import write_report

        for path in write_report(record, Path(report)):
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
) -> int:
    """Simulated robot, reference controller and service on this machine; ends with the mission.

    Args:
        asked, formula: see `run_service`.
    """
    config = on_a_free_port(config)
    _prepare(report)
    record = None
    try:
        started = children(config, stop, ("sim", "--no-motion"), ("motion",))
        with started, suppress(Stopped):  # `started` says it when a child that ended was the cause
            record = _serve(config, stop, True, asked, formula)
    finally:  # a child's failure must not cost the report
        code = 0 if record is None else _conclude(record, report)
    return code


def run_simulator(config: Config, stop: threading.Event, motion: bool) -> int:
    """The simulated robot in this process, the reference controller in another."""
    from edge.sim.process import main as run_sim

    with children(config, stop, *([("motion",)] if motion else [])):
        return run_sim(config, stop)
