"""Has what is known of places written beside the loop, and reads it at the start."""

from __future__ import annotations

import logging
import time
from functools import partial
from pathlib import Path

from edge.config import Config
from edge.host.machine import boot_id
from edge.loop.place_file import FILE, Places, decode, encode
from edge.loop.places import Kept, Now, Parts, gather, make_map, why_elsewhere
from edge.mapping.grid import RollingMap
from edge.mapping.tiles import MOST_PER_STEP, Batch, Copier, PackedTiles
from edge.mapping.window import TILE
from edge.mission.checkpoint import CheckpointWriter, Format, load, set_aside

log = logging.getLogger("edge.loop.place_keeper")

PERIOD_S = 3.0
"""How often a state is begun to be copied; it is on the disk some ticks and a write later."""
SUFFIX = ".map"
_PLACES = Format(encode, decode, FILE)
_LAST_S = 5.0  # for the last write


class PlaceKeeper:
    """Keeps places in a file; for the loop's thread.

    What the file held waits for the first observation, which tells whether `map` is still the frame
    that it is in. Until then nothing is written.

    Attributes:
        problem: why the file that was there is of no use, "" where there is none such.
        read: what the file held, as long as it may be taken up.
        waiting: the map of it, until the first observation.
    """

    def __init__(self, config: Config, path: Path) -> None:
        """
        Raises:
            CheckpointError: there is a file and it cannot be read, or none can be written.
        """
        self._config, self._path, self._boot = config, path, boot_id()
        loaded = load(path, _PLACES)
        self.problem = loaded.problem
        self.read: Places | None = loaded.saved
        self.waiting: RollingMap | None = None
        self._writer: CheckpointWriter[Places] = CheckpointWriter(path, PERIOD_S, _PLACES)
        self._copier, self._packed = Copier(), PackedTiles()
        self._due = False
        self._last: tuple[Parts, Now, tuple[str, ...], str] | None = None

    def prepare(self) -> None:
        """Make the map anew, so that the first tick has but to take it."""
        if self.read is None:
            return
        try:
            self.waiting = make_map(self.read.kept, self.read.unpacked, self._config)
        except ValueError as error:
            self.read, self.problem = None, set_aside(self._path, str(error))

    def why_elsewhere(self, now: Now) -> str:
        """See `edge.loop.places.why_elsewhere`, of what waits."""
        return why_elsewhere(self.read.kept, now, self._boot, self._config)

    def take(self, elsewhere: str) -> tuple[RollingMap, Kept] | None:
        """What waits, once.

        Args:
            elsewhere: why the robot's frame is another, "" where it is the same: else it is
                dropped.
        """
        grid, self.waiting = self.waiting, None
        kept = self.read.kept
        if not self._config.source.localised:  # nothing goes back to it any more
            self.read = None
        if elsewhere:
            log.info("%s: what was mapped and seen before the restart is dropped", elsewhere)
            return None
        if kept["map/cells"] != grid.window.n:
            log.info("mapping.extent_m is another than before the restart: the map is cut to it")
        return grid, kept

    def jumped(self) -> None:
        """The pose jumped. Where it is one in a map that lasts, only what was mapped since the
        start is void: the robot may have been told only now where it is."""
        if self._config.source.localised:
            self._last = None
            self.prepare()

    def note(
        self, parts: Parts, now: Now, targets: tuple[str, ...], target: str, changed: bool
    ) -> None:
        """Copy some of it if it is time, and hand it to the writer once it is whole; never blocks.

        Args:
            targets: of the mission; `target` is the active one.
            changed: in a way that is worth being kept at once.
        """
        if self.waiting is not None:  # nothing was observed yet
            return
        self._last = parts, now, targets, target
        self._due = self._due or changed or self._writer.due(now.now_ns)
        if self._due and self._writer.idle:
            self._copy(MOST_PER_STEP + parts.map.grid.tiles_of_update)

    @property
    def idle(self) -> bool:
        """Whether all that was handed to the writer is on the disk, or could not be written."""
        return self._writer.idle

    @property
    def written(self) -> int:
        """How often it was written."""
        return self._writer.written

    @property
    def trouble(self) -> str:
        """Why it could not be written the last time, or not be read; "" where all is well."""
        return self._writer.problem or self.problem

    def close(self) -> None:
        """Write how it stands, if there is time."""
        until_s = time.monotonic() + _LAST_S
        while not self._writer.idle and time.monotonic() < until_s:
            time.sleep(0.005)
        if self._last is not None and self._writer.idle:
            self._copy(self._last[0].map.grid.window.written.size)
        self._writer.close()

    def _copy(self, most: int) -> None:
        parts, now, targets, target = self._last
        grid = parts.map.grid
        if not self._copier.step(grid.window, grid.planes, most):
            return
        self._due = False
        kept = gather(parts, now, self._boot, targets, target)
        anew, batches = self._copier.take()
        self._writer.post(partial(self._pack, kept, grid.window.n, anew, batches), now.now_ns)

    def _pack(self, kept: Kept, n: int, anew: bool, batches: list[Batch]) -> Places:
        """On the writer's thread."""
        if anew:
            self._packed = PackedTiles()
        self._packed.update(batches)
        x, y = (int(at) // TILE for at in kept["map/origin"])
        xy, tiles = self._packed.all((x, y), n // TILE)
        return Places({**kept, "tile/xy": xy}, tuple(tiles))
