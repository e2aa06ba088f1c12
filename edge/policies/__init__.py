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

from edge.config import PolicyPlugin
from edge.config.components import component_factory
from edge.policies.base import Policy

# Kind of a policy → its class.
REGISTRY = {
    "hvl": "edge.policies.hvl:HvlPolicy",
    "vlfm": "edge.policies.value_map:ValueMapPolicy",
    "directional": "edge.policies.value_map:ValueMapPolicy",
    "adaptive": "edge.policies.adaptive:AdaptivePolicy",
    "nearest_frontier": "edge.policies.nearest_frontier:NearestFrontierPolicy",
    "search": "edge.policies.search:SearchPolicy",
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
        ConfigError: see `edge.config.components.component_factory`.
    """
    where, needs = f"{path}: policy", ("score()", "reset()")
    if isinstance(config, PolicyPlugin):
        plugin = config.kind, config.options, REGISTRY, where, needs, tuple(given)
        return partial(component_factory("policy", *plugin), **given)
    make = component_factory("policy", config.kind, {}, REGISTRY, where, needs, ("config",))
    return partial(make, config=config)


def make_policy(
    config: Any, path: str = "<defaults>", given: Mapping[str, Any] = MappingProxyType({})
) -> Policy:
    """Make the policy of a configuration's `policy` section; see `find_policy`.

    Example:
        >>> from edge.config import PolicyNearest
        >>> type(make_policy(PolicyNearest())).__name__
        'NearestFrontierPolicy'
    """
    return find_policy(config, path, given)()
