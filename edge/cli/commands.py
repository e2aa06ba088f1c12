"""What `edge run`, `edge demo` and `edge sim` do."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, NamedTuple

from edge.cli.console import ConsoleSink, RecorderSink
from edge.config import Config
from edge.errors import FAILED, Stopped, UserError
from edge.host.children import python_module
from edge.host.ports import free_port
from edge.loop.latency import LatencyReport
from edge.loop.runner import loop, open_service
from edge.report.recorder import RunRecord
from edge.text import one_line
from edge.types import MissionStatus

log = logging.getLogger("edge")

_CHILD_STOP_S = 5.0
_CHILD_LOOK_S = 0.2


class Outcome(NamedTuple):
    """What a run of the service leaves."""

    status: MissionStatus
    latency: LatencyReport
    record: RunRecord


def run_service(
    config: Config,
    stop: threading.Event,
    once: bool,
    report: str | None,
    asked: str | None = None,
    formula: str | None = None,
) -> int:
    """Run the service; the exit code, see `edge.errors`.

    Args:
        asked, formula: the mission as given on the command line; see `open_service`.

    Raises:
        UserError: no report can be written there (said before the run).
        Stopped: `stop` was set before the service was ready.
    """
    _prepare(report)
    return _conclude(_serve(config, stop, once, asked, formula), report)


def _prepare(report: str | None) -> None:
    if report is not None:
        from edge.report.page import prepare

        prepare(report)


def _serve(
    config: Config, stop: threading.Event, once: bool, asked: str | None, formula: str | None
) -> Outcome:
    recorder = RecorderSink(config)
    with open_service(config, [ConsoleSink(), recorder], asked, formula, stop) as running:
        instruction = running.service.mission.brief.translation.instruction
        log.info("ready: %s, on %s", one_line(instruction), config.zenoh.endpoint)
        status = loop(running, stop, once)
        record = recorder.record(running.service, running.source.counters)
        return Outcome(status, running.service.latency.report(), record)


def _conclude(outcome: Outcome, report: str | None) -> int:
    """Print how it went, write the report; the exit code."""
    print(outcome.latency.table())
    print(summary(outcome.status))
    if report is not None:
        from edge.report.page import write_report

        for path in write_report(outcome.record, Path(report)):
            print(path)
    return FAILED if outcome.status.phase == "failed" else os.EX_OK


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
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = config.model_copy(
        update={"zenoh": config.zenoh.model_copy(update={"endpoint": endpoint})}
    )
    _prepare(report)
    outcome = None
    try:
        started = children(config, stop, ("sim", "--no-motion"), ("motion",))
        with started, suppress(Stopped):  # `started` says it when a child that ended was the cause
            outcome = _serve(config, stop, True, asked, formula)
    finally:  # a child's failure must not cost the report
        code = 0 if outcome is None else _conclude(outcome, report)
    return code


def run_simulator(config: Config, stop: threading.Event, motion: bool) -> int:
    """The simulated robot in this process, the reference controller in another."""
    from edge.sim.process import main as run_sim

    with children(config, stop, *([("motion",)] if motion else [])):
        return run_sim(config, stop)


@contextmanager
def children(
    config: Config, stop: threading.Event, *commands: tuple[str, ...]
) -> Iterator[list[subprocess.Popen[bytes]]]:
    """`edge COMMAND` processes with this configuration; they end with the block.

    A child gets the whole configuration in a file, since the environment's overrides and `--target`
    are already in it.

    Args:
        stop: set when a child ends before the block does: there is nothing to go on with.

    Raises:
        UserError: a child could not be started, or ended by itself.
    """
    environ = {k: v for k, v in os.environ.items() if not k.startswith("EDGE__")}
    started: list[subprocess.Popen[bytes]] = []
    with _in_memory(config) as file:
        path = f"/proc/self/fd/{file.fileno()}"
        try:
            for command, *options in commands:
                arguments = [*python_module("edge.cli"), "--log-level", "warning"]
                arguments += [command, path, "--with-parent", str(os.getpid()), *options]
                try:
                    # A session of its own keeps the terminal's Ctrl-C for the parent, which
                    # stops its children in order.
                    child = subprocess.Popen(
                        arguments, env=environ, start_new_session=True, pass_fds=(file.fileno(),)
                    )
                except OSError as error:
                    raise UserError(f"cannot start edge {command}: {error.strerror}") from None
                started.append(child)
            with _watched(started, stop):
                yield started
            _check([command for command, *_ in commands], started)
        finally:
            _stop(started)


def _in_memory(config: Config) -> BinaryIO:
    """A file with the configuration and no name: nothing is left of it however this process ends,
    and none but children can read what secrets it holds."""
    file = open(os.memfd_create("edge-config"), "wb")  # noqa: SIM115
    file.write(config.model_dump_json(exclude={"path"}).encode())
    file.flush()
    return file


@contextmanager
def _watched(started: list[subprocess.Popen[bytes]], stop: threading.Event) -> Iterator[None]:
    """Sets `stop` as soon as one of the processes ends."""
    over = threading.Event()

    def watch() -> None:
        while not over.wait(_CHILD_LOOK_S):
            if any(child.poll() is not None for child in started):
                stop.set()
                return

    thread = threading.Thread(target=watch, name="children", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _check(names: list[str], started: list[subprocess.Popen[bytes]]) -> None:
    """Raises UserError for the first process that has ended by itself."""
    for name, child in zip(names, started, strict=True):
        code = child.poll()
        if code is not None:
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            error = UserError(f"edge {name} ended before its time ({how}): see what it said above")
            error.exit_code = code if code > 0 else os.EX_SOFTWARE
            raise error


def _stop(started: list[subprocess.Popen[bytes]]) -> None:
    for child in started:
        with suppress(ProcessLookupError):
            child.send_signal(signal.SIGTERM)
    for child in started:
        try:
            child.wait(_CHILD_STOP_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
