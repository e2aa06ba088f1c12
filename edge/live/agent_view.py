"""Pictures of the map and of the camera for agents."""

from __future__ import annotations

import time
from typing import Any

from edge.errors import UserError
from edge.live.pictures import grid_json, shot_json
from edge.live.sink import LiveSink
from edge.loop.result import TickResult
from edge.types import CAMERAS

_WAIT_S = 2.0  # longest wait for the loop to make a picture
_POLL_S = 0.05


class AgentView(LiveSink):
    """A sink that keeps map and camera images while an agent asks for pictures.

    Attributes:
        newest: a result of the last `PERIOD_S`, for its map; None while no agent asks.
    """

    newest: TickResult | None = None

    def picture(self, of: str) -> dict[str, Any]:
        """Return the picture as JSON with base64; waits, so not for the loop's thread.

        Args:
            of: `map`, `camera`, or `camera2` for the second camera.

        Raises:
            UserError: there is no picture yet.
        """
        until_s = time.monotonic() + _WAIT_S
        while time.monotonic() < until_s:
            self.mark_watched()
            newest, shots = self.newest, self.shots
            if of == "map" and newest is not None:
                return grid_json(newest.snapshot())
            if of != "map" and (shot := shots.get(CAMERAS.index(of))) is not None:
                return shot_json(shot)
            time.sleep(_POLL_S)
        raise UserError(f"no {of} picture within {_WAIT_S:g} s: has the robot sensors?")

    def _drop(self) -> None:
        super()._drop()
        self.newest = None

    def _keep(self, result: TickResult, now_s: float) -> None:
        self.newest = result
