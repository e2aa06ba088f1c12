"""Spans (durations of ticks and stages) in the trace event format, for Perfetto and Chrome.

https://docs.google.com/document/d/1CvAClvFfyA5R-PhYUmn5OOQtYMH4h6I0nSsKchNAySU defines the format.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from http import HTTPStatus
from typing import Any

from edge.host.web_server import GetRoutes, HttpResponse, json_response
from edge.loop.latency import Span

PAGE = "/trace"
PID, LOOP = 1, 1  # numbers of the process, and of the loop's thread
_US = 1e-3  # microseconds in a nanosecond


def trace_of(spans: Iterable[Span]) -> dict[str, Any]:
    """Return one event for each span, in microseconds since the first span.

    The loop's thread has the ticks and their stages; each background stage has a thread. Of a
    background stage only the time is known at which its result was used. A span that seems to begin
    before the previous one ended is cut to begin there.
    """
    # With an equal begin, a tick comes before its first stage, which is shorter.
    ordered = sorted(spans, key=lambda s: (s.begin_ns, -s.took_ns))
    first_ns = min((span.begin_ns for span in ordered), default=0)
    threads = {"loop": LOOP}
    ends_ns: dict[int, int] = {}  # thread → end of its last span
    events = []
    for name, begin_ns, took_ns, in_tick in ordered:
        thread = LOOP
        if not in_tick:
            thread = threads.setdefault(name, LOOP + len(threads))
            end_ns = begin_ns + took_ns
            begin_ns = max(begin_ns, ends_ns.get(thread, begin_ns))
            took_ns = max(0, end_ns - begin_ns)
            ends_ns[thread] = begin_ns + took_ns
        events.append({
            "name": name, "cat": "tick" if in_tick else "background", "ph": "X",
            "ts": (begin_ns - first_ns) * _US, "dur": took_ns * _US, "pid": PID, "tid": thread,
        })  # fmt: skip
    return {"traceEvents": [*_name_events(threads), *events], "displayTimeUnit": "ms"}


def _name_events(threads: dict[str, int]) -> Iterable[dict[str, Any]]:
    names = [("process_name", LOOP, "edge")]
    names += [("thread_name", thread, name) for name, thread in threads.items()]
    for kind, thread, name in names:
        yield {"name": kind, "ph": "M", "pid": PID, "tid": thread, "args": {"name": name}}


def trace_bytes(spans: Iterable[Span]) -> bytes:
    """Return `trace_of` as JSON."""
    return json.dumps(trace_of(spans), separators=(",", ":"), allow_nan=False).encode()


class TracePage:
    """The page `/trace`: the latency ring of the running service.

    Attributes:
        spans: see `edge.loop.latency.LatencyRing.spans`; None before the service starts.
    """

    def __init__(self) -> None:
        self.spans: Callable[[], list[Span]] | None = None

    def pages(self) -> GetRoutes:
        """Return the page by its path."""
        return {PAGE: self._page}

    def _page(self) -> HttpResponse:
        if self.spans is None:
            return json_response({"error": "starting"}, HTTPStatus.SERVICE_UNAVAILABLE)
        return HttpResponse(trace_bytes(self.spans()), "application/json")
