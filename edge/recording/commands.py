"""The command `edge replay`, with `--recover` and `--trace`."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx

from edge.config import load
from edge.errors import FAILED, ConfigError, UnavailableError
from edge.host.credentials import read_token
from edge.host.files import save
from edge.loop.latency import Span
from edge.loop.warmup import warm_up
from edge.recording import channels, file
from edge.recording.file import PARTIAL, RecordingError
from edge.recording.journal import MAX_VALUES
from edge.recording.replay import ReplayResult
from edge.recording.replay import replay as replay_run
from edge.recording.session import RecordedRun
from edge.recording.trace import PAGE, trace_bytes
from edge.text import format_table, one_line, read_json

_TIMEOUT_S = 10.0  # timeout of the request to the service
MAX_SPANS = 2_000_000
"""Most spans of a trace, about an hour; each takes a kilobyte while the trace is written."""


def replay(args: argparse.Namespace) -> int:
    """Run `edge replay`; return 1 if results differ or could not all be compared.

    Raises:
        UserError: see `edge.recording.replay.replay`.
    """
    run = RecordedRun(Path(args.file), getattr(args, "trust", False))
    config = None if args.config is None else load(args.config)
    warm_up(config or run.config())
    outcome = replay_run(run, config, args.detect)
    print(format_result(run, outcome))
    return FAILED if outcome.differing or run.gap or not outcome.ticks else os.EX_OK


def format_result(run: RecordedRun, o: ReplayResult) -> str:
    """Format the outcome of a replay."""
    files = f" and {len(run.files) - 1} more" if len(run.files) > 1 else ""
    lines = [
        f"{run.head.path}{files}: {o.ticks} ticks, {o.seconds:.1f} s, recorded by edge "
        f"{run.head.edge}",
        f"goals: {o.goals_then} recorded, {o.goals_now} replayed; final phase "
        f"{one_line(o.phase_then) or '-'} recorded, {o.phase_now or '-'} replayed",
    ]
    if o.n_unrecorded:
        lines.append(f"{o.n_unrecorded} images for the detector were not recorded: raise rgb_hz")
    if o.ended:
        lines.append(f"ends early: {o.ended}")
    if o.first is None:
        lines.append("identical in every tick" if o.ticks else "it has no ticks to compare")
    else:
        at = o.first
        lines.append(
            f"differs in {o.differing} of {o.ticks} ticks, first in tick {at.tick} (stamp "
            f"{at.stamp_ns}):"
        )
        lines.append(
            format_table([("", "recorded", "replayed"), *_differing(at.recorded, at.replayed)])
        )
    return "\n".join(lines)


def _differing(
    then: dict[str, Any] | None, now: dict[str, Any] | None
) -> Iterator[tuple[str, str, str]]:
    """Yield (name, recorded, replayed) of each decision that differs."""
    for key in ("target", "phase", "goal", "sent"):
        a, b = (None if decisions is None else decisions[key] for decisions in (then, now))
        if a != b:
            yield key, _text_of(a), _text_of(b)


def _text_of(value: Any) -> str:
    """Return a decision as text: a goal, a list of goals, or a word."""
    if isinstance(value, list):
        return "; ".join(map(_text_of, value)) or "-"
    if not isinstance(value, dict):
        return "-" if value is None else one_line(value)
    x_m, y_m, yaw_rad = value["pose"]
    kind, number, target = (one_line(value[name], 40) for name in ("kind", "id", "target"))
    return (
        f"{kind} {number} of {target} at "
        f"{x_m:.3f} {y_m:.3f} {yaw_rad:.3f}, score {value['score']:.6g}"
    )


def recover(args: argparse.Namespace) -> int:
    """Run `edge replay --recover`.

    Raises:
        RecordingError: the file cannot be read, or the copy cannot be written.
    """
    path = Path(args.file)
    out = args.out or path.with_name(path.name.removesuffix(PARTIAL))
    if args.out is None and out == path:
        out = path.with_name(f"{path.stem}.recovered.mcap")
    n, why = file.recover(path, out)
    print(f"{out}: {n} messages; {path} was {why or 'complete'}")
    return os.EX_OK


def trace(args: argparse.Namespace) -> int:
    """Run `edge replay --trace`.

    Raises:
        UserError: no such recording or service, or the file cannot be written.
    """
    if args.file.endswith((".mcap", PARTIAL)):
        content = trace_bytes(spans_of(Path(args.file)))
    else:
        content = _ask_service(args.file)
    out = args.out or Path("trace.json")
    save(out, content)
    print(f"{out}: open it in https://ui.perfetto.dev")
    return os.EX_OK


def spans_of(path: Path) -> list[Span]:
    """Return the first `MAX_SPANS` spans of a recorded run, from this file on.

    Raises:
        RecordingError: see `edge.recording.session.read_header`; or there are no spans.
    """
    spans: list[Span] = []
    run = RecordedRun(path)
    for m in run.messages():
        if m.topic == channels.SPANS.topic:
            spans += _parse_spans(path, m.payload)
        if len(spans) >= MAX_SPANS:
            print(f"{path}: only its first {MAX_SPANS} spans; name a later file for more")
            return spans[:MAX_SPANS]
    if not spans:
        raise RecordingError(
            f"{run.truncation or path}: has no cycle of a service; name the recording of a "
            "service that ran"
        )
    return spans


def _parse_spans(path: Path, payload: bytes) -> list[Span]:
    try:
        spans = [Span(*span) for span in read_json(payload, MAX_VALUES)["spans"]]
        trace_bytes(spans)
    except Exception as error:  # damaged data can raise anything
        why = f"{type(error).__name__}: {one_line(error, 120)}"
        raise RecordingError(f"{path}: damaged: the durations cannot be read: {why}") from None
    return spans


def _ask_service(name: str) -> bytes:
    """Return the trace page of the running service of a configuration."""
    http = load(name).http
    if http.port is None:
        raise ConfigError(f"{name}: http.port: not set, so the service has no page: set a port")
    headers = {}
    if http.token_file is not None:
        headers = read_token("http.token_file", http.token_file).header()
    where = f"http://{http.host}:{http.port}{PAGE}"
    try:
        answer = httpx.get(where, headers=headers, timeout=_TIMEOUT_S)
        answer.raise_for_status()
    except httpx.HTTPError as error:
        raise UnavailableError(f"{where}: {one_line(error)}: is the service running?") from None
    return answer.content
