"""Streets: the same for a seed, nothing on anything, and drivable as a world."""

from __future__ import annotations

import hashlib
import json
import math

import pytest

from edge.config import parse
from edge.lab.sim.generator.rng import Rect
from edge.lab.sim.street import street
from edge.lab.sim.worlds import load_world

SEEDS = range(12)
WORLD = {"kind": "street", "seed": 1}


def test_a_seed_is_a_street():
    assert street(3) == street(3)
    assert street(3) != street(4)
    assert street(3) != street(3, 1)


def test_streets_of_a_seed_never_change():
    """Results name it."""
    digest = hashlib.sha256()
    for seed in range(200):
        drawn = street(seed, 0)
        rows = [(g.id, g.label, g.rect.x0, g.rect.y0, g.rect.x1, g.rect.y1) for g in drawn.grounds]
        rows += [(t.label, t.colour, t.x_m, t.y_m, t.yaw_rad, *t.size_m) for t in drawn.objects]
        rows.append((drawn.start.x_m, drawn.start.y_m, drawn.start.yaw_rad))
        rounded = [[round(v, 6) if isinstance(v, float) else v for v in row] for row in rows]
        digest.update(json.dumps(rounded).encode())
    assert digest.hexdigest()[:16] == "4470662e85ac3c6f"


def test_streets_differ_in_grounds_and_objects():
    drawn = [street(seed) for seed in range(60)]
    assert {len(s.grounds) for s in drawn} == {3, 4, 5}
    labels = {item.label for s in drawn for item in s.objects}
    assert labels == {"house", "car", "van", "tree", "pole", "trash can", "bench"}


@pytest.mark.parametrize("seed", SEEDS)
def test_objects_do_not_overlap(seed):
    drawn = street(seed)
    rects = [item.rect for item in drawn.objects]
    robot = Rect(drawn.start.x_m - 1, drawn.start.y_m - 1, drawn.start.x_m + 1, drawn.start.y_m + 1)
    for k, rect in enumerate(rects):
        assert not any(rect.meets(other) for other in [robot, *rects[:k]])


def test_a_street_is_loaded_as_a_world():
    drawn = street(1)
    config = parse({"perception": {"detector": {"kind": "sim"}}, "sim": {"world": WORLD}})
    world = load_world(config)
    assert len(world.objects) == len(drawn.objects)
    assert world.plan.clearance_at(0.0, 0.0) > 0.5
    ahead = drawn.to_map(30.0, 0.0)
    reached = world.plan.reachable(0.0, 0.0, 0.4)
    assert reached[world.plan.grid.cell_of(ahead.x_m, ahead.y_m)]
    car = next(item for item in world.objects if item.label == "car")
    assert world.plan.clearance_at(*car.center_m[:2]) == 0.0
    assert math.dist(car.size_m, (4.3, 1.8, 1.5)) < 0.5
