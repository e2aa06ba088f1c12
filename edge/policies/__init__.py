"""Goal choice: one small file a policy, one interface, chosen by `policy.kind`.

A new policy is a file with a class that scores candidates, a section in `edge/config/policy.py`
and a line in `REGISTRY`.
"""

from __future__ import annotations

from typing import Any

from edge.policies.base import Policy
from edge.policies.hvl import Hvl
from edge.policies.nearest_frontier import NearestFrontier

REGISTRY: dict[str, Any] = {"hvl": Hvl, "nearest_frontier": NearestFrontier}


def make_policy(config: Any) -> Policy:
    """The policy that a configuration's `policy` section names."""
    return REGISTRY[config.kind](config)
