"""How candidates are scored, and how one of them is chosen."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Union

from pydantic import Discriminator, Field, Tag

from edge.config.section import (
    MODULE_CLASS,
    Fraction,
    NonNegative,
    OwnKind,
    Positive,
    Section,
    kind_of,
)


class _Selection(Section):
    """What all policies have: how algorithm 2 of VL-Nav chooses by their scores.

    A frontier nearer than `delta_reached_m` is done with; another candidate must be better than
    the present one by `switch_margin`, as a fraction of its score; a frontier that moved less than
    `r_assoc_m` is still the same. `instances: false` leaves out the approach to what may be the
    target (III.C): the robot follows frontiers, and goes only to what the detector confirmed in
    passing, for there an episode ends.
    """

    delta_reached_m: NonNegative = 0.5
    r_assoc_m: Positive = 0.6
    switch_margin: NonNegative = 0.3
    instances: bool = True
    look_round: bool = False


class PolicyHvl(_Selection):
    """VL-Nav eq. 2-8; `instances` and `heuristics` are its ablations (table I).

    `distance` of eq. 5 is along the path, or straight as in the paper. `w_context` is what boxes
    of what is no target count in eq. 3, beside those of the target; 0: nothing.
    """

    kind: Literal["hvl"] = "hvl"
    w_dist: NonNegative = 0.5
    w_vl: NonNegative = 1.0
    w_context: NonNegative = 3.0
    distance: Literal["path", "straight"] = "path"
    heuristics: bool = True


class PolicyNearest(_Selection):
    """The nearest frontier; instances first (a baseline)."""

    kind: Literal["nearest_frontier"] = "nearest_frontier"
    distance: Literal["path", "straight"] = "path"


class PolicySearch(_Selection):
    """Ours: the area that a frontier would show, under a root, over the way there, times the
    prior's lift."""

    kind: Literal["search"] = "search"
    look_round: bool = True


class PolicyVlfm(_Selection):
    """The frontier near which the whole-view scores are best (VLFM); needs a similarity scorer.
    `nearness`: see `PolicyDirectional`."""

    kind: Literal["vlfm"] = "vlfm"
    switch_margin: NonNegative = 0.05
    radius_m: Positive = 0.5
    nearness: Positive = 1e-3


class PolicyDirectional(_Selection):
    """The frontier near which the directional scores are best (ViTL eq. 9); needs a choice
    scorer. `nearness` over a metre more than the path is added to a value: with as little as the
    default it only decides where values are the same, as in the paper."""

    kind: Literal["directional"] = "directional"
    switch_margin: NonNegative = 0.05
    radius_m: Positive = 0.5
    nearness: Positive = 1e-3


class PolicyAdaptive(_Selection):
    """ApexNav's rule. If the frontiers' values differ enough, a tour through those within `keep`
    of the best is begun; else the robot goes to the nearest by path."""

    kind: Literal["adaptive"] = "adaptive"
    by: Literal["similarity", "choice", "prior"] = "similarity"
    radius_m: Positive = 0.5
    keep: Fraction = 0.9


class PolicyOwn(_Selection):
    """A class of one's own, on Python's path; `options` are its arguments (docs/policies.md)."""

    kind: OwnKind = MODULE_CLASS
    options: dict[str, Any] = Field(default_factory=dict)


Policy = Annotated[
    Union[
        Annotated[PolicyHvl, Tag("hvl")],
        Annotated[PolicyVlfm, Tag("vlfm")],
        Annotated[PolicyDirectional, Tag("directional")],
        Annotated[PolicyAdaptive, Tag("adaptive")],
        Annotated[PolicyNearest, Tag("nearest_frontier")],
        Annotated[PolicySearch, Tag("search")],
        Annotated[PolicyOwn, Tag(MODULE_CLASS)],
    ],
    Discriminator(kind_of),
]
