"""Goal selection: policies that score candidates, and VL-Nav algorithm 2 that picks one.

`policy.kind` names an entry of `REGISTRY`, or a plugin as `module:Class` (docs/policies.md).
To add a policy: write a class with the interface of `edge.policies.base`, add its section to
`edge/config/policy.py` and a line to `REGISTRY`. This package sends no goals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

from edge.config import PolicyOwn
from edge.config.named import find_named
from edge.policies.base import Policy

REGISTRY = {
    "hvl": "edge.policies.hvl:Hvl",
    "vlfm": "edge.policies.by_value:ByValue",
    "directional": "edge.policies.by_value:ByValue",
    "adaptive": "edge.policies.adaptive:Adaptive",
    "nearest_frontier": "edge.policies.nearest_frontier:NearestFrontier",
    "search": "edge.policies.search:Search",
}


def find_policy(
    config: Any, path: str = "<defaults>", given: Mapping[str, Any] = MappingProxyType({})
) -> Callable[[], Policy]:
    """Return a function that makes the policy of a configuration's `policy` section.

    A policy of this package gets the section. A plugin gets its options.

    Args:
        config: the `policy` section.
        path: path of the configuration file, for error messages.
        given: arguments that a plugin may request in addition to its options, by parameter name.

    Raises:
        ConfigError: see `edge.config.named.find_named`.
    """
    where, needs = f"{path}: policy", ("score()", "reset()")
    if isinstance(config, PolicyOwn):
        own = config.kind, config.options, REGISTRY, where, needs, tuple(given)
        return partial(find_named("policy", *own), **given)
    make = find_named("policy", config.kind, {}, REGISTRY, where, needs, ("config",))
    return partial(make, config=config)


def make_policy(
    config: Any, path: str = "<defaults>", given: Mapping[str, Any] = MappingProxyType({})
) -> Policy:
    """Make the policy of a configuration's `policy` section; see `find_policy`.

    Example:
        >>> from edge.config import PolicyNearest
        >>> type(make_policy(PolicyNearest())).__name__
        'NearestFrontier'
    """
    return find_policy(config, path, given)()
