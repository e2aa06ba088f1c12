"""Goal choice: one small file a policy, one interface (`edge.policies.base`), and algorithm 2.

`policy.kind` names one of `REGISTRY`, or one's own by `module:Class` (docs/policies.md). A new
one of ours is a file with a class that scores candidates, a section in `edge/config/policy.py`
and a line in `REGISTRY`. Nothing here sends a goal or knows who asks.
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
    """What makes the policy that a configuration's `policy` section names.

    One of ours is given the section, one's own its options.

    Args:
        path: of the configuration, for errors.
        given: what one's own may ask for besides its options, by the name of the parameter.

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
    """See `find_policy`."""
    return find_policy(config, path, given)()
