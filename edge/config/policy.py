"""The section of the policy, which scores candidates and chooses one of them."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Union

from pydantic import Discriminator, Field, Tag

from edge.config.section import (
    MODULE_CLASS,
    Fraction,
    NonNegative,
    PluginKind,
    Positive,
    Section,
    kind_of,
)

UNKNOWN_RADIUS_M = 1.0
"""Radius of the circle around a frontier in which `hvl` counts unknown cells (VL-Nav eq. 6)."""


class _Selection(Section):
    """Keys of all policies: the selection by score (VL-Nav algorithm 2).

    Attributes:
        delta_reached_m: a frontier nearer than this counts as visited.
        r_assoc_m: a frontier that moved less than this as the map grew is still the same.
        switch_margin: the goal changes only to a candidate whose score is better by this fraction.
        instances: false: do not approach objects that may be the target (VL-Nav III.C). The robot
            then goes only to objects that were confirmed in passing.
        spin: true: a full turn on the spot is a candidate, too; `search` and `nearest_frontier`
            score it like a frontier, the others choose it last.
    """

    # Confirmed objects come before others, whatever their scores.
    confirmed_first: ClassVar[bool] = True
    delta_reached_m: NonNegative = 0.5
    r_assoc_m: Positive = 0.6
    switch_margin: NonNegative = 0.3
    instances: bool = True
    spin: bool = False


class PolicyHvl(_Selection):
    """VL-Nav's score (eq. 2 to 8); `instances` and `heuristics` are its ablations (table I).

    Attributes:
        w_dist: weight of the distance.
        w_vl: weight of the vision-language score.
        w_context: weight of boxes of other objects in eq. 3; 0: only boxes of the target count.
        distance: distance of eq. 5, along the `path`, or `straight` as in the paper.
        heuristics: false: leave out the distance and the unknown area around a frontier.
    """

    kind: Literal["hvl"] = "hvl"
    w_dist: NonNegative = 0.5
    w_vl: NonNegative = 1.0
    w_context: NonNegative = 3.0
    distance: Literal["path", "straight"] = "path"
    heuristics: bool = True


class PolicyNearest(_Selection):
    """The nearest frontier; objects that may be the target come first (a baseline).

    Attributes:
        distance: along the `path`, or `straight`.
    """

    kind: Literal["nearest_frontier"] = "nearest_frontier"
    distance: Literal["path", "straight"] = "path"


class PolicySearch(_Selection):
    """Our search: root of the unknown area that a frontier shows, over the path length.

    The score is multiplied by the likelihood ratio of the prior.
    """

    confirmed_first: ClassVar[bool] = False  # the score already says how sure an object is
    kind: Literal["search"] = "search"
    spin: bool = True


class PolicyVlfm(_Selection):
    """The frontier with the best image-text score nearby (VLFM).

    It needs `perception.similarity`.

    Attributes:
        radius_m: scores within this distance of a frontier count for it.
        nearness: weight of 1 / (1 m + path length), which is added to the score. The small default
            only decides between equal scores.
    """

    kind: Literal["vlfm"] = "vlfm"
    switch_margin: NonNegative = 0.05
    radius_m: Positive = 0.5
    nearness: Positive = 1e-3


class PolicyDirectional(_Selection):
    """The frontier with the best directional score nearby (ViTL eq. 9).

    It needs `perception.choice`.

    Attributes:
        radius_m: scores within this distance of a frontier count for it.
        nearness: weight of 1 / (1 m + path length), which is added to the score. The small default
            only decides between equal scores, as in the paper.
    """

    kind: Literal["directional"] = "directional"
    switch_margin: NonNegative = 0.05
    radius_m: Positive = 0.5
    nearness: Positive = 1e-3


class PolicyAdaptive(_Selection):
    """ApexNav's rule: a tour through the best frontiers, or the nearest one.

    The tour is driven if the frontiers' values differ enough; else the nearest by path is chosen.

    Attributes:
        by: source of the values.
        radius_m: values within this distance of a frontier count for it.
        keep: the tour takes frontiers of at least this fraction of the best value.
    """

    kind: Literal["adaptive"] = "adaptive"
    by: Literal["similarity", "choice", "prior"] = "similarity"
    radius_m: Positive = 0.5
    keep: Fraction = 0.9


class PolicyPlugin(_Selection):
    """Your own policy class (docs/policies.md).

    Attributes:
        kind: the class as `module:Class`; the module's folder must be on PYTHONPATH.
        options: arguments of the class.
    """

    kind: PluginKind = MODULE_CLASS
    options: dict[str, Any] = Field(default_factory=dict)


Policy = Annotated[
    Union[
        Annotated[PolicyHvl, Tag("hvl")],
        Annotated[PolicyVlfm, Tag("vlfm")],
        Annotated[PolicyDirectional, Tag("directional")],
        Annotated[PolicyAdaptive, Tag("adaptive")],
        Annotated[PolicyNearest, Tag("nearest_frontier")],
        Annotated[PolicySearch, Tag("search")],
        Annotated[PolicyPlugin, Tag(MODULE_CLASS)],
    ],
    Discriminator(kind_of),
]
