"""A room of a map, made by hand."""

from __future__ import annotations

import numpy as np

from edge.memory import MappedRoom
from edge.perception.prior.table import load

KITCHEN = MappedRoom(
    3, "", ("kitchen",), {"kitchen": 0.9, "bedroom": 0.1}, np.zeros(len(load().things), np.float32),
    np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)]), 12.0, (2.0, 1.5), 0.5,
    np.zeros((0, 2), np.float32), (), True,
)  # fmt: skip
