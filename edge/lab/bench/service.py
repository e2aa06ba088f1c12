"""`edge bench`: run the real service on a recording and print its latency table.

Another process plays the recording over Zenoh in a loop, at its recorded rate. The service does not
know that it is measured. A robot's own recording has no Zenoh topics: it is played once, in this
process (`edge.sources.played`).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from subprocess import Popen

from edge.bus.topics import Topic
from edge.config import Config, load
from edge.errors import Stopped, UserError
from edge.host import calibration, resources
from edge.host.interruptible import raise_if_stopped
from edge.host.progress import ProgressBar
from edge.host.signals import stop_on_signals
from edge.loop import stages

log = logging.getLogger("edge.lab.bench.service")

RECORDING_S = 60.0  # length of the built-in recording
_VERSION = 1  # of the built-in recording; a new number makes it again
_PLAYER_S = 60.0  # longest wait for the first observation of a recording

Message = tuple[Topic, int, bytes]
"""Topic, stamp in ns, and payload of a message."""


def run(args: argparse.Namespace) -> int:
    """Handle `edge bench`."""
    if args.calibrate:
        return calibrate()
    started_s = process_age_s()
    config = load(args.config)
    stop = stop_on_signals()
    recording = Path(args.recording) if args.recording else ensure_recording(config, stop=stop)
    figures = run_bench(config, recording, args.seconds, stop, started_s)
    print(figures.pop("table"))
    for name, (value, unit, limit) in figures["verdicts"].items():
        verdict = "ok  " if value <= limit else "OVER"
        print(f"{verdict}  {name:24} {value:9.2f} {unit}   (budget {limit:.3g} {unit})")
    if args.json:
        args.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    over = any(value > limit for value, _, limit in figures["verdicts"].values())
    return 1 if over and args.enforce else 0


def calibrate() -> int:
    """Handle `edge bench --calibrate`."""
    found = calibration.measure()
    parts = ", ".join(f"{name} {times:.2f}" for name, times in found.parts.items())
    print(f"{found.machine}: {found}\ntime relative to the reference computer: {parts}")
    print(f"saved to {calibration.save(found)}")
    return 0


def run_bench(
    config: Config,
    recording: Path,
    seconds: float,
    stop: threading.Event,
    started_s: float = 0.0,
) -> dict[str, object]:
    """Run the service on a recording, for `seconds` from the first observation on.

    `started_s`, the time that the interpreter took to start, is part of getting ready.

    Returns:
        `table` (text), `latency` (the report as a dict), `counters`, and `verdicts`: name → (value,
            unit, budget).

    Raises:
        UserError: the recording cannot be read, or no tick or no detection happened.
        Stopped: `stop` was set before the service was ready.
    """
    began_s = time.perf_counter() - started_s  # imports are part of getting ready
    from edge.launch import open_service, with_free_port
    from edge.loop.runner import loop
    from edge.sources.played import Playback
    from edge.sources.recording import player

    config = with_free_port(config).model_copy(
        update={
            # The mission must outlast the recording.
            "mission": config.mission.model_copy(update={"time_limit_s": 1e6, "path_limit_m": 1e6})
        }
    )
    raise_if_stopped(stop)
    with ExitStack() as stack:
        playback = stack.enter_context(Playback(recording, config, 1.0, stop))
        began_s += playback.read_s  # reading the recording is not part of it
        playback.check()
        # Another process plays a recording with Zenoh topics; a robot's own is played here.
        has_topics = playback.has_bus_topics
        for line in () if has_topics else playback.describe_contents():
            log.info("%s", line)
        own = {} if has_topics else {"make_source": playback.open, "clock": playback.clock}
        running = stack.enter_context(open_service(config, [], stop=stop, **own))
        ready_s = time.perf_counter() - began_s
        log.info(
            "service ready after %.1f s; playing %s for %g s", ready_s, recording.name, seconds
        )
        if has_topics:
            process = stack.enter_context(player(config, recording))
        is_over = partial(_has_failed, process) if has_topics else lambda seen: playback.is_over
        stop_in_time = _stopwatch(running.source.counters, is_over, seconds, stop)
        loop(running, stop, each=stop_in_time)
        report = running.service.latency.report()
        counters = dict(running.source.counters)
        memory_mb = resident_mb()
        failing = "; ".join(check.message for check in running.service.plausibility.failed)
        if not has_topics:
            for line in playback.describe_outcome():
                log.info("%s", line)
    tick = report.tick
    slowdown = 1.0 if report.calibration is None else report.calibration.slowdown
    if tick.n == 0 or report.stage("detect").n == 0:
        detections = report.stage("detect").n
        why = failing or ("use more --seconds" if has_topics else "see the log")
        raise UserError(
            f"bench: measured {tick.n} ticks and {detections} detections in {seconds:g} s, needs "
            f"at least 1 of each: {why} (counters: {counters})"
        )
    return {
        "table": report.table(),
        "latency": report.as_dict(),
        "counters": counters,
        "verdicts": {
            "tick p95": (tick.p95_ms, "ms", tick.budget_ms),
            "tick p99": (tick.p99_ms, "ms", report.deadline_ms),
            "resident memory": (memory_mb, "MB", stages.MEMORY_BUDGET_MB),
            "ready after": (ready_s, "s", stages.READY_BUDGET_S * slowdown),
        },
    }


def _stopwatch(
    counters: Mapping[str, int],
    is_over: Callable[[bool], bool],
    seconds: float,
    stop: threading.Event,
) -> Callable[[], None]:
    """Return a function to call after every tick, which ends the measurement in time.

    It sets `stop` when `seconds` have passed since the first observation, when the recording is
    over, or when the recording takes too long to start. `is_over` returns True if no more messages
    will come; its argument is True after the first observation.
    """
    end_s, seen = time.monotonic() + _PLAYER_S, False

    def stop_in_time() -> None:
        nonlocal end_s, seen
        if not seen and counters.get("observations"):
            end_s, seen = time.monotonic() + seconds, True
        if time.monotonic() >= end_s or is_over(seen):
            stop.set()

    return stop_in_time


def _has_failed(player: Popen[bytes], seen: bool) -> bool:
    """Return True if the player ended before the first observation was `seen`."""
    return not seen and player.poll() is not None


def resident_mb() -> float:
    """Return the resident memory of this process in MB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def process_age_s() -> float:
    """Return the time since this process was started (Linux)."""
    # Field 22 of proc(5), counted from the end of the second one, which may contain spaces.
    start_ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
    uptime_s = float(Path("/proc/uptime").read_text().split()[0])
    return max(0.0, uptime_s - start_ticks / os.sysconf("SC_CLK_TCK"))


def ensure_recording(
    config: Config, seconds: float = RECORDING_S, stop: threading.Event | None = None
) -> Path:
    """Return a recording of a drive through the built-in house; the seeded simulator makes it once.

    It depends only on the sensors and the robot, so configurations share it. It is kept in the
    cache.

    Raises:
        RecordingError: the file cannot be written.
        Stopped: `stop` was set before the recording was complete; no file is left.
    """
    from edge.sources.recording import RecordingError, record_messages

    parts = [_VERSION, seconds, config.sensors.model_dump(), config.robot.model_dump()]
    key = hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:12]
    path = resources.cache_dir() / "recordings" / f"house-{key}.mcap"
    if not path.exists():
        from edge.lab.eval.house_drive import house_drive

        log.info("making the recording for edge bench, once: %s", path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(
                f"{path.parent}: cannot be made: {error.strerror}; set EDGE_CACHE_DIR to a "
                "writable folder"
            ) from None
        began = time.perf_counter()
        record_messages(path, _with_progress(house_drive(config, seconds), seconds, stop))
        size_mb, took_s = path.stat().st_size / 1e6, time.perf_counter() - began
        log.info("recording complete: %g s, %.0f MB, made in %.0f s", seconds, size_mb, took_s)
    return path


def _with_progress(
    messages: Iterable[Message], seconds: float, stop: threading.Event | None
) -> Iterator[Message]:
    """Yield the messages, and show their recorded seconds on a bar."""
    first_ns = None
    with ProgressBar("recording", round(seconds)) as bar:
        for message in messages:
            if stop is not None and stop.is_set():
                raise Stopped("stopped by request while making the recording of edge bench")
            first_ns = message[1] if first_ns is None else first_ns
            bar.set_done((message[1] - first_ns) // 1_000_000_000)
            yield message
