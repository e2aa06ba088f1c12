"""How candidates are scored."""

from __future__ import annotations

from typing import Annotated, Literal, Union

from pydantic import Field

from edge.config.section import NonNegative, Positive, Section


class PolicyHvl(Section):
    """VL-Nav eq. 2-8 and algorithm 2; the two switches are its ablations (table I).

    `instances: false` leaves out the approach to what may be the target (III.C): the robot follows
    frontiers, and goes only to what the detector confirmed in passing, for there an episode ends.
    """

    kind: Literal["hvl"] = "hvl"
    sigma_rad: Positive = 0.1
    w_dist: NonNegative = 0.5
    w_vl: NonNegative = 1.0
    unknown_k: Positive = 2.0
    unknown_radius_m: Positive = 1.0
    delta_reached_m: NonNegative = 0.5
    r_assoc_m: Positive = 0.6
    instances: bool = True
    heuristics: bool = True
    switch_margin: NonNegative = 0.3


class PolicyNearest(Section):
    """The nearest frontier; instances first (a baseline)."""

    kind: Literal["nearest_frontier"] = "nearest_frontier"
    delta_reached_m: NonNegative = 0.5
    r_assoc_m: Positive = 0.6
    switch_margin: NonNegative = 0.3


Policy = Annotated[Union[PolicyHvl, PolicyNearest], Field(discriminator="kind")]
