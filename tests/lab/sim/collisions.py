"""Positions that the simulated robot cannot enter."""

from __future__ import annotations

from edge.lab.sim.base import World


def collides(world: World, x_m: float, y_m: float, radius_m: float) -> bool:
    """Return True if a disc at a position touches an obstacle or leaves the world."""
    return world.plan.clearance_at(x_m, y_m) < radius_m
