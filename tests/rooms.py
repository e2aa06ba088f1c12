"""A room of a map, made by hand."""

from __future__ import annotations

import numpy as np

from edge.memory import MappedRoom
from edge.perception.prior.table import load

KITCHEN = MappedRoom(
    id=3, region=1, polygon_m=np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)]),
    area_m2=12.0, xy_m=(2.0, 1.5), inside_m=0.5, points_m=np.zeros((0, 2), np.float32), doors=(),
    names=(), kinds=("kitchen",), chance={"kitchen": 0.9, "bedroom": 0.1},
    held=np.zeros(len(load().classes), np.float32), is_visited=True,
)  # fmt: skip
