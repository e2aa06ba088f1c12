"""Checkpoint of the objects' pictures, in a file next to the map's.

Pictures are larger than the rest and change rarely, so they are written less often. A picture of
the last half minute may be lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from edge.host.checkpoint import Checkpoint, CheckpointFormat, CheckpointWriter, load, quarantine
from edge.memory import MAX_CROP_BYTES, CropStore

SUFFIX = ".crops"
PERIOD_S = 30.0
"""Shortest time between two writes."""


@dataclass(frozen=True)
class CropState:
    """Description of the saved pictures; all data is in the arrays."""

    n: int


CROPS = CheckpointFormat("edge-crops", "file of pictures", CropState, MAX_CROP_BYTES + (1 << 20))
"""Format of the file."""


class CropCheckpoint:
    """The file of the pictures; for the loop's thread.

    Attributes:
        problem: reason why an existing file cannot be used; "" if there is none.

    Raises:
        CheckpointError: the file cannot be read, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._loaded, self.problem = load(path, CROPS)
        self.writer = CheckpointWriter(path, CROPS, PERIOD_S)
        self._queued_changes = 0  # `CropStore.changes` when the pictures were last queued

    def restore(self, crops: CropStore) -> None:
        """Load the pictures of the file; the map of the same run was restored before."""
        if self._loaded is None:
            return
        try:
            crops.load_state_dict(self._loaded.arrays)
        except ValueError as error:
            self._loaded, self.problem = None, quarantine(self.writer.path, str(error))
        self._queued_changes = crops.changes

    def save_if_changed(self, crops: CropStore, now_ns: int) -> None:
        """Pass the pictures to the writer if the file lacks any and it is time. Never block."""
        if self._is_file_old(crops) and self.writer.is_due(now_ns):
            self._post(crops, now_ns)

    def close(self, crops: CropStore | None) -> None:
        """Write the last pictures, and stop the writer; `crops` is None if there was no tick."""
        if crops is not None and self._is_file_old(crops):
            self._post(crops, 0)
        self.writer.close()

    def _is_file_old(self, crops: CropStore) -> bool:
        """Return True if pictures changed, or could not be written."""
        return crops.changes != self._queued_changes or self.writer.problem != ""

    def _post(self, crops: CropStore, now_ns: int) -> None:
        """Queue the pictures for the writer."""
        self._queued_changes, n, take = crops.changes, len(crops), crops.snapshot()
        self.writer.post(lambda: Checkpoint(CropState(n), take()), now_ns)
