"""HTTP pages of the live view: the page itself, its data, and requests to the service."""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Callable, Mapping
from functools import partial
from hashlib import blake2b
from http import HTTPStatus
from pathlib import Path
from typing import Any

from edge.bus import topics
from edge.bus.request_queue import RequestQueue
from edge.bus.verbs import error_of
from edge.config import Config
from edge.geometry import Grid
from edge.host.web_server import GetRoutes, HttpResponse, PostRoutes
from edge.live.page_json import (
    MAX_LAYERS,
    log_json,
    memory_json,
    site_json,
    snapshot_json,
    task_json,
)
from edge.live.pictures import grid_json, shot_json
from edge.live.sink import LiveSink, LiveSnapshot
from edge.loop.service_health import ServiceHealth

ANSWER_S = 120.0
"""Timeout of a request: a language model may have to process it."""
_LATENCY_TICKS = 300
_TOO_CLOSE = 50  # map value of cells near obstacles, which the page draws differently
_FOLDER = Path(__file__).parent / "page"
_KINDS = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}
_FILES = {
    "/" if path.name == "index.html" else f"/live/{path.name}": path
    for path in sorted(_FOLDER.iterdir())
    if path.suffix in _KINDS
}
PUBLIC = tuple(_FILES)
"""Pages without a token: they have no data of the robot."""


class LiveView:
    """Serves the page; all methods but `sink.tick` run on HTTP threads.

    Args:
        config: the configuration.
        vitals: health of the service, from its start on.

    Attributes:
        sink: receives the results.
    """

    def __init__(self, config: Config, vitals: ServiceHealth) -> None:
        self.sink = LiveSink()
        self._config, self._vitals = config, vitals
        self._queues: Mapping[str, RequestQueue] = {}
        self._lock = threading.Lock()  # one thread encodes, for all viewers
        self._cached: dict[str, tuple[object, HttpResponse]] = {}

    def open(self, queues: Mapping[str, RequestQueue]) -> None:
        """Accept requests from now on, with a queue for each key."""
        self._queues = queues

    def pages(self) -> GetRoutes:
        """Return the page and its data, by path."""
        layers = {f"/live/layers/{i}": partial(self._layer, i) for i in range(MAX_LAYERS)}
        return {
            **{path: partial(_file, file) for path, file in _FILES.items()},
            "/live/now": self._now,
            "/live/story": self._mission_log,
            "/live/task": self._task,
            "/live/site": self._site,
            "/live/memory": self._memory,
            "/live/map": self._map,
            "/live/camera": self._camera,
            **layers,
        }

    def forms(self) -> PostRoutes:
        """Return the handlers of requests, the same as on the bus: see `edge.loop.requests`."""
        return {f"/{key}": partial(self._request, key) for key in topics.REQUESTS}

    # -- data ----------------------------------------------------------------------------------

    def _now(self) -> HttpResponse:
        now_s = self.sink.mark_watched()
        moment, shot, ticked_s = self.sink.snapshot, self.sink.shot, self.sink.ticked_s
        why = self._vitals.problems()
        return _json(
            {
                "robot": self._config.robot_name,
                "radius_m": self._config.robot.radius_m,
                "service": {"state": self._vitals.state, "ready": not why, "why": why},
                "controls": self._config.http.token_file is not None,
                "silent_s": None if ticked_s is None else round(now_s - ticked_s, 1),
                "shot": None if shot is None else shot.seq,
                "moment": None if moment is None else snapshot_json(moment),
            }
        )

    def _mission_log(self) -> HttpResponse:
        moment = self._viewed_moment()
        if moment is None:
            return _json(None)
        return _json(log_json(moment, moment.result.latency(last=_LATENCY_TICKS)))

    def _task(self) -> HttpResponse:
        moment = self._viewed_moment()
        if moment is None or moment.task is None:
            return _json(None)
        task = moment.task
        return self._once("task", moment.n_tasks, lambda: _json(task_json(task, moment.n_tasks)))

    def _site(self) -> HttpResponse:
        moment = self._viewed_moment()
        if moment is None:
            return _json(None)
        return self._once("site", moment.n_sites, lambda: _json(site_json(moment)))

    def _memory(self) -> HttpResponse:
        moment = self._viewed_moment()
        return _json(None if moment is None else memory_json(moment))

    def _map(self) -> HttpResponse:
        moment = self._viewed_moment()
        if moment is None:
            return _json(None)
        return self._grid("map", partial(moment.result.snapshot, inflated=_TOO_CLOSE))

    def _layer(self, index: int) -> HttpResponse:
        moment = self._viewed_moment()
        layers = [] if moment is None else list(moment.layers.items())
        return self._grid(*layers[index]) if index < len(layers) else _json(None)

    def _camera(self) -> HttpResponse:
        self._viewed_moment()
        if (shot := self.sink.shot) is None:
            return _json(None)
        return self._once("camera", shot.seq, lambda: _json(shot_json(shot)))

    def _viewed_moment(self) -> LiveSnapshot | None:
        self.sink.mark_watched()
        return self.sink.snapshot

    def _grid(self, name: str, take: Callable[[], Grid]) -> HttpResponse:
        grid = take()
        said = blake2b(grid.cells, digest_size=8)
        said.update(f"{grid.origin_xy_m} {grid.resolution_m} {grid.cells.shape}".encode())
        tag = said.hexdigest()
        return self._once(name, tag, lambda: _json({"name": name, **grid_json(grid)}, tag))

    def _once(self, name: str, version: object, make: Callable[[], HttpResponse]) -> HttpResponse:
        """Return a page that is encoded once per version, for all viewers."""
        with self._lock:
            kept = self._cached.get(name)
            if kept is None or kept[0] != version:
                if len(self._cached) > MAX_LAYERS:  # layers of earlier missions
                    self._cached.clear()
                kept = self._cached[name] = version, make()
            return kept[1]

    # -- requests ------------------------------------------------------------------------------

    def _request(self, key: str, body: bytes) -> HttpResponse:
        if key not in self._queues:
            state = self._vitals.state
            return HttpResponse(
                error_of(f"the service is {state}"), _JSON, HTTPStatus.SERVICE_UNAVAILABLE
            )
        answers: queue.SimpleQueue[tuple[bytes, bool]] = queue.SimpleQueue()
        self._queues[key].accept(body, lambda reply, is_error: answers.put((reply, is_error)))
        try:
            reply, is_error = answers.get(timeout=ANSWER_S)
        except queue.Empty:
            reply, is_error = error_of(f"no answer within {ANSWER_S:g} s"), True
        return HttpResponse(reply, _JSON, HTTPStatus.CONFLICT if is_error else HTTPStatus.OK)


_JSON = "application/json"


def _json(said: Any, etag: str = "") -> HttpResponse:
    body = json.dumps(said, separators=(",", ":"), allow_nan=False).encode()
    return HttpResponse(body, _JSON, etag=etag)


def _file(path: Path) -> HttpResponse:
    return HttpResponse(path.read_bytes(), f"{_KINDS[path.suffix]}; charset=utf-8")
