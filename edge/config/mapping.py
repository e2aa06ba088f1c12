"""The section `mapping`: the occupancy map."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from edge.config.section import NonNegative, Positive, Section

MAX_RADIUS_CELLS = 31
"""Largest radius of the circle in which unknown cells are counted: a row must fit 64 bits."""
MAX_CELLS = 4096
"""Most cells on a side. The map allocates about 10 bytes for each cell at the start."""


class MappingConfig(Section):
    """The rolling occupancy map (VL-Nav III.A, III.B).

    Attributes:
        input: sensor that makes the map: `depth` images, or the LiDAR's `cloud`.
        resolution_m: side of a cell; at least 0.0323 for the policy `hvl`.
        extent_m: side of the square map around the robot.
        range_m: measurements up to this distance are used.
        min_range_m: nearer measurements are ignored.
        inflation_m: cells with their middle within this distance of an occupied cell are closed.
            Default: 0.2 m, or `robot.radius_m` if that is larger.
        obstacle_min_m: points lower than this above the floor are floor.
        obstacle_max_m: the robot passes under points higher than this above the floor. Default: its
            height plus 0.2 m, or plus a quarter of its height if that is less.
    """

    input: Literal["depth", "cloud"] = "depth"
    resolution_m: Annotated[float, Field(ge=0.01, le=1.0)] = 0.05
    extent_m: Annotated[float, Field(gt=0, le=MAX_CELLS)] = 50.0
    range_m: Positive = 5.0
    min_range_m: NonNegative = 0.1
    inflation_m: NonNegative = 0.2
    obstacle_min_m: Positive = 0.10
    obstacle_max_m: Positive = 1.0

    @model_validator(mode="after")
    def _check_sizes(self) -> MappingConfig:
        least_m = 2 * (self.range_m + 2 * self.inflation_m) + 1.0
        if self.extent_m < least_m:
            raise ValueError(
                f"extent_m {self.extent_m:g}: must be at least 2 * (range_m + 2 * inflation_m) + 1 "
                f"= {least_m:g}"
            )
        if self.min_range_m >= self.range_m:
            raise ValueError(
                f"min_range_m {self.min_range_m:g}: must be below range_m {self.range_m:g}, or no "
                "measurement is used"
            )
        if self.extent_m / self.resolution_m > MAX_CELLS:
            finest_m = math.ceil(1000 * self.extent_m / MAX_CELLS) / 1000
            raise ValueError(
                f"extent_m {self.extent_m:g} at resolution_m {self.resolution_m:g}: more than "
                f"{MAX_CELLS} cells a side; set extent_m to at most "
                f"{math.floor(MAX_CELLS * self.resolution_m)}, or resolution_m to at least "
                f"{finest_m:g}"
            )
        if self.obstacle_max_m <= self.obstacle_min_m:
            raise ValueError(
                f"obstacle_max_m {self.obstacle_max_m:g} (by default from robot.height_m): must be "
                f"above obstacle_min_m {self.obstacle_min_m:g}"
            )
        return self
