"""Goal choice: one small file a policy, one interface (`edge.policies.base`), and algorithm 2.

`policy.kind` names one of `REGISTRY`, or one's own by `module:Class` (docs/policies.md). A new
one of ours is a file with a class that scores candidates, a section in `edge/config/policy.py`
and a line in `REGISTRY`. Nothing here sends a goal or knows who asks.
"""

from __future__ import annotations

from typing import Any

from edge.config import PolicyOwn
from edge.config.named import check_call, find_class
from edge.errors import ConfigError, UserError
from edge.policies.base import Policy
from edge.policies.hvl import Hvl
from edge.policies.nearest_frontier import NearestFrontier
from edge.text import one_line

REGISTRY: dict[str, Any] = {"hvl": Hvl, "nearest_frontier": NearestFrontier}


def make_policy(config: Any, path: str = "<defaults>") -> Policy:
    """The policy that a configuration's `policy` section names.

    Args:
        path: of the configuration, for errors.

    Raises:
        ConfigError: one's own class is not there, does not take its options, or is no policy.
    """
    where = f"{path}: policy"
    make = find_class(config.kind, REGISTRY, f"{where}.kind")
    if not isinstance(config, PolicyOwn):
        return make(config)
    check_call(make, 0, config.options, f"{where}.options")
    try:
        policy = make(**config.options)
    except UserError:
        raise
    except Exception as error:  # whatever one's own class does
        said = one_line(f"{type(error).__name__}: {error}")
        raise ConfigError(f"{where}.options: {config.kind}: {said}") from None
    if missing := [name for name in ("score", "reset") if not hasattr(policy, name)]:
        raise ConfigError(f"{where}.kind: {config.kind} is no policy: it has no {missing[0]}()")
    return policy
