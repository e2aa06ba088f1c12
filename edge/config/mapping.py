"""The occupancy map."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from edge.config.section import NonNegative, Positive, Section

MAX_CELLS = 4096
"""Most cells on a side: the map takes some 10 bytes for each cell, all of them at the start."""


class Mapping(Section):
    """The rolling occupancy map (VL-Nav III.A, III.B).

    Where the robot was held up by something that no sensor shows (a sill, glass) the map stays
    closed for `bump_memory_s`. Cells whose middle is within `inflation_m` of the rim of an occupied
    cell are closed. The robot passes under what is higher over the floor than `obstacle_max_m`: by
    default its height and 0.2 m, or a quarter of its height if that is less.
    """

    input: Literal["depth", "cloud"] = "depth"
    resolution_m: Annotated[float, Field(ge=0.01, le=1.0)] = 0.05
    extent_m: Annotated[float, Field(gt=0, le=MAX_CELLS)] = 50.0
    range_m: Positive = 5.0
    min_range_m: NonNegative = 0.1
    inflation_m: NonNegative = 0.2
    obstacle_min_m: Positive = 0.10
    obstacle_max_m: Positive = 1.0
    bump_memory_s: Positive = 600.0

    @model_validator(mode="after")
    def _fits(self) -> Mapping:
        if self.extent_m < 2 * (self.range_m + 2 * self.inflation_m) + 1.0:
            raise ValueError("extent_m: must be over twice range_m plus inflation on both sides")
        if self.extent_m / self.resolution_m > MAX_CELLS:
            finest_m = math.ceil(1000 * self.extent_m / MAX_CELLS) / 1000
            raise ValueError(
                f"extent_m {self.extent_m:g} at resolution_m {self.resolution_m:g}: more than "
                f"{MAX_CELLS} cells a side; take extent_m up to "
                f"{math.floor(MAX_CELLS * self.resolution_m)}, or resolution_m from {finest_m:g}"
            )
        if self.obstacle_max_m <= self.obstacle_min_m:
            raise ValueError(
                f"obstacle_max_m {self.obstacle_max_m:g} (by default from robot.height_m): must be "
                f"above obstacle_min_m {self.obstacle_min_m:g}"
            )
        return self
