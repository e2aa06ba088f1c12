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
from edge.bus.stop import StopRequests
from edge.bus.verbs import error_payload
from edge.config import Config
from edge.geometry import Grid
from edge.host.web_server import GetRoutes, HttpResponse, PostRoutes
from edge.live.page_json import (
    MAX_LAYERS,
    log_json,
    memory_json,
    page_task_json,
    site_json,
    snapshot_json,
)
from edge.live.pictures import grid_json, shot_json
from edge.live.sink import LiveSink, LiveSnapshot
from edge.loop.monitoring.service_health import ServiceHealth
from edge.types import CAMERAS

ANSWER_S = 120.0
"""Timeout of a request: a language model may have to process it."""
_LATENCY_TICKS = 300  # newest ticks in the table of latencies
_TOO_CLOSE = 50  # map value of cells near obstacles, which the page draws differently
_FOLDER = Path(__file__).parent / "page"
_MEDIA_TYPES = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}
_FILES = {
    "/" if path.name == "index.html" else f"/live/{path.name}": path
    for path in sorted(_FOLDER.iterdir())
    if path.suffix in _MEDIA_TYPES
}
PUBLIC = tuple(_FILES)
"""Pages without a token: they have no data of the robot."""


class LiveView:
    """Serves the page; all methods but `sink.tick` run on HTTP threads.

    Attributes:
        sink: receives the results.
    """

    def __init__(self, config: Config, health: ServiceHealth) -> None:
        self.sink = LiveSink()
        self._config, self._health = config, health
        # By key of `edge.bus.topics.REQUESTS`.
        self._queues: dict[str, RequestQueue | StopRequests] = {}
        self._lock = threading.Lock()  # so that one thread encodes for all viewers
        self._cached: dict[str, tuple[object, HttpResponse]] = {}  # name → version, response

    def open(self, queues: Mapping[str, RequestQueue | StopRequests]) -> None:
        """Accept requests of these keys from now on."""
        self._queues = {**self._queues, **queues}

    def pages(self) -> GetRoutes:
        """Return the page and its data, by path."""
        layers = {f"/live/layers/{i}": partial(self._layer, i) for i in range(MAX_LAYERS)}
        return {
            **{path: partial(_file, file) for path, file in _FILES.items()},
            "/live/now": self._now,
            "/live/mission": self._mission_log,
            "/live/task": self._task,
            "/live/site": self._site,
            "/live/memory": self._memory,
            "/live/map": self._map,
            **{f"/live/{name}": partial(self._camera, i) for i, name in enumerate(CAMERAS)},
            **layers,
        }

    def forms(self) -> PostRoutes:
        """Return the handlers of requests, as on the bus (`edge.loop.requests.handlers`)."""
        return {f"/{key}": partial(self._request, key) for key in topics.REQUESTS}

    # -- data ----------------------------------------------------------------------------------

    def _now(self) -> HttpResponse:
        """Return the data that change all the time; `status` is from the newest snapshot."""
        now_s = self.sink.mark_watched()
        snapshot, shots, ticked_s = self.sink.snapshot, self.sink.shots, self.sink.ticked_s
        why = self._health.problems()
        return _json(
            {
                "robot": self._config.robot_name,
                "radius_m": self._config.robot.radius_m,
                "service": {"state": self._health.state, "ready": not why, "why": why},
                "controls": self._config.http.token_file is not None,
                "silent_s": None if ticked_s is None else round(now_s - ticked_s, 1),
                "shots": {CAMERAS[i]: shot.seq for i, shot in shots.items()},
                "status": None if snapshot is None else snapshot_json(snapshot),
            }
        )

    def _mission_log(self) -> HttpResponse:
        snapshot = self._watched_snapshot()
        if snapshot is None:
            return _json(None)
        return _json(log_json(snapshot, snapshot.result.latency(last=_LATENCY_TICKS)))

    def _task(self) -> HttpResponse:
        snapshot = self._watched_snapshot()
        if snapshot is None or (task := snapshot.result.task()) is None:
            return _json(None)
        return self._cached_response(
            "task", snapshot.n_tasks, lambda: _json(page_task_json(task, snapshot.n_tasks))
        )

    def _site(self) -> HttpResponse:
        snapshot = self._watched_snapshot()
        if snapshot is None:
            return _json(None)
        return self._cached_response("site", snapshot.n_sites, lambda: _json(site_json(snapshot)))

    def _memory(self) -> HttpResponse:
        snapshot = self._watched_snapshot()
        return _json(None if snapshot is None else memory_json(snapshot))

    def _map(self) -> HttpResponse:
        snapshot = self._watched_snapshot()
        if snapshot is None:
            return _json(None)
        return self._grid("map", partial(snapshot.result.snapshot, inflated=_TOO_CLOSE))

    def _layer(self, index: int) -> HttpResponse:
        snapshot = self._watched_snapshot()
        layers = [] if snapshot is None else list(snapshot.layers.items())
        return self._grid(*layers[index]) if index < len(layers) else _json(None)

    def _camera(self, index: int) -> HttpResponse:
        self._watched_snapshot()
        if (shot := self.sink.shots.get(index)) is None:
            return _json(None)
        return self._cached_response(CAMERAS[index], shot.seq, lambda: _json(shot_json(shot)))

    def _watched_snapshot(self) -> LiveSnapshot | None:
        """Record that a person views the page, and return the newest snapshot, if any."""
        self.sink.mark_watched()
        return self.sink.snapshot

    def _grid(self, name: str, copy_grid: Callable[[], Grid]) -> HttpResponse:
        """Return a grid, with a tag by which a browser sees that it has not changed."""
        grid = copy_grid()
        digest = blake2b(grid.cells, digest_size=8)
        digest.update(f"{grid.origin_xy_m} {grid.resolution_m} {grid.cells.shape}".encode())
        tag = digest.hexdigest()
        return self._cached_response(
            name, tag, lambda: _json({"name": name, **grid_json(grid)}, tag)
        )

    def _cached_response(
        self, name: str, version: object, make: Callable[[], HttpResponse]
    ) -> HttpResponse:
        """Return a response that is made once per version, for all viewers."""
        with self._lock:
            cached = self._cached.get(name)
            if cached is None or cached[0] != version:
                if len(self._cached) > MAX_LAYERS:  # layers of earlier missions
                    self._cached.clear()
                cached = self._cached[name] = version, make()
            return cached[1]

    # -- requests ------------------------------------------------------------------------------

    def _request(self, key: str, body: bytes) -> HttpResponse:
        """Pass a request to the loop, and wait for its answer."""
        if key not in self._queues:
            state = self._health.state
            return HttpResponse(
                error_payload(f"the service is {state}"), _JSON, HTTPStatus.SERVICE_UNAVAILABLE
            )
        answers: queue.SimpleQueue[tuple[bytes, bool]] = queue.SimpleQueue()
        self._queues[key].accept(body, lambda reply, is_error: answers.put((reply, is_error)))
        try:
            reply, is_error = answers.get(timeout=ANSWER_S)
        except queue.Empty:
            reply, is_error = error_payload(f"no answer within {ANSWER_S:g} s"), True
        return HttpResponse(reply, _JSON, HTTPStatus.CONFLICT if is_error else HTTPStatus.OK)


_JSON = "application/json"


def _json(data: Any, etag: str = "") -> HttpResponse:
    body = json.dumps(data, separators=(",", ":"), allow_nan=False).encode()
    return HttpResponse(body, _JSON, etag=etag)


def _file(path: Path) -> HttpResponse:
    return HttpResponse(path.read_bytes(), f"{_MEDIA_TYPES[path.suffix]}; charset=utf-8")
