"""Rooms of the running service: a background thread cuts the map into rooms for `RoomMemory`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from edge.host.worker import Worker
from edge.mapping.points import TALL
from edge.mapping.regions import survey_regions
from edge.mapping.view import MapView
from edge.memory import RoomMemory, RoomSurvey, survey_rooms

PERIOD_NS = 1_000_000_000
"""Shortest time between two surveys."""


class RoomSurveyor:
    """Cuts the map into rooms in the background, about once a second.

    Args:
        inline: cut the map inside `step`, so that a run is reproducible.
    """

    def __init__(self, inline: bool) -> None:
        self._worker: Worker[Callable[[], RoomSurvey], RoomSurvey] = Worker(
            "rooms", lambda survey: survey(), inline=inline
        )
        self._requested_ns: int | None = None

    def wrap_workers(self, wrap: Callable[[str, Any], Any]) -> None:
        """Wrap the worker with `wrap`, which logs its requests and results."""
        self._worker = wrap("rooms", self._worker)

    def step(self, rooms: RoomMemory, view: MapView, now_ns: int) -> None:
        """Pass a finished survey to `rooms`, and start the next when it is due, once a tick.

        A survey is one cut of the entire map.
        """
        is_due = self._requested_ns is None or now_ns - self._requested_ns >= PERIOD_NS
        if is_due and self._worker.idle:
            self._requested_ns = now_ns
            layers, window, before = view.layers, view.window, rooms.survey
            self._worker.submit(lambda: survey_rooms(survey_regions(layers, window, TALL), before))
        if (found := self._worker.poll()) is not None:
            rooms.on_survey(found)

    def discard_pending(self) -> None:
        """Drop surveys of a map that is gone."""
        self._worker.discard_all()
        self._requested_ns = None

    def close(self) -> None:
        """Stop the background work."""
        self._worker.close()
