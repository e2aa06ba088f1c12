"""Learning the prior: plans of houses, a searcher on them, and the fit."""

from __future__ import annotations

import gzip
import json
import math

import numpy as np
import pytest

from edge.perception.prior import table
from exporters.training.prior import learn
from exporters.training.prior.__main__ import main
from exporters.training.prior.counts import count_kinds
from exporters.training.prior.explorer import Explorer, paths_m
from exporters.training.prior.house import CELL_M, read_plan
from exporters.training.prior.samples import Samples, gather, starting_cells


def house(
    *objects: tuple[str, float, float], door: tuple[float, float] | None = (1.5, 2.5)
) -> dict:
    """Return a bathroom and a bedroom of 4 m × 4 m with a door between them."""
    walls = [[0, 0, 8, 0], [8, 0, 8, 4], [8, 4, 0, 4], [0, 4, 0, 0]]
    walls += [[4, 0, 4, 4]] if door is None else [[4, 0, 4, door[0]], [4, door[1], 4, 4]]
    return {
        "name": "two rooms",
        "rooms": [
            {"category": "bathroom", "polygon": [[0, 0], [4, 0], [4, 4], [0, 4]]},
            {"category": "bedroom", "polygon": [[4, 0], [8, 0], [8, 4], [4, 4]]},
        ],
        "walls": [[*wall, 0.0, 2.6] for wall in walls],
        "objects": [
            {
                "id": str(i),
                "category": name,
                "center": [x, y, 0.3],
                "size": [0.4, 0.4, 0.6],
                "yaw": 0,
            }
            for i, (name, x, y) in enumerate(objects)
        ],
    }  # fmt: skip


def cell(plan, x_m: float, y_m: float) -> tuple[int, int]:
    x, y = np.floor((np.array([x_m, y_m]) - plan.origin_xy_m) / CELL_M).astype(int).tolist()
    return y, x


def test_a_plan_of_a_house():
    plan = read_plan(house(("toilet", 1, 1), ("bed", 6, 3)))
    assert plan.kinds == ("bathroom", "bedroom")
    assert plan.doors == {(0, 1)}
    assert plan.words == ("bed", "toilet")
    assert plan.object_room.tolist() == [0, 1]
    assert plan.wall[cell(plan, 4.0, 0.5)]
    assert not plan.wall[cell(plan, 4.0, 2.0)]
    assert plan.closed[cell(plan, 1.0, 1.0)]
    assert not plan.wall[cell(plan, 1.0, 1.0)]
    assert plan.closed[cell(plan, -0.3, 1.0)]
    assert not read_plan(house(door=None)).doors


def test_an_object_inside_another_is_left_out():
    inside = house(("bed", 6, 3), ("pillow", 6, 3))
    inside["objects"][1]["size"] = [0.1, 0.1, 0.1]
    assert read_plan(inside).words == ("bed",)


def test_kinds_are_counted():
    plans = [read_plan(house(("toilet", 1, 1), ("bed", 6, 3)))] * 2
    plans.append(read_plan(house(("bed", 6, 3), door=None)))
    counted = count_kinds(plans, ["bed", "toilet"], ["bathroom", "bedroom"])
    assert counted["rooms"] == [3, 3]
    assert counted["rooms_with"] == [[0, 2], [3, 0]]
    assert counted["pairs"] == [[0, 3], [3, 0]]
    assert counted["doors"] == [[0, 2], [2, 0]]


def test_an_explorer_sees_only_objects_in_line_of_sight():
    plan = read_plan(house(("toilet", 1, 3), ("bed", 7, 0.6)))
    explorer = Explorer(plan, cell(plan, 1, 1), np.random.default_rng(0))
    for _ in range(5):
        explorer.look(None)
    assert dict(zip(("toilet", "bed"), explorer.seen.tolist(), strict=True)) == {
        "toilet": True, "bed": False,
    }  # fmt: skip
    assert explorer.known[cell(plan, 3, 3)]
    assert not explorer.known[cell(plan, 7, 0.6)]
    toilet = explorer.object_m[0]
    assert np.hypot(*(explorer.seen_m[0] - toilet)) == pytest.approx(0.2, abs=1e-5)
    frontiers = explorer.frontiers()
    assert len(frontiers.cell)
    assert (frontiers.path_m < 8).all()


def test_paths_go_through_the_door():
    plan = read_plan(house(("bed", 7, 1)))
    path = paths_m(plan, cell(plan, 1, 1))
    straight = math.hypot(7 - 1, 1.9 - 1)
    assert straight < path[cell(plan, 7, 1.9)] < straight + 1.5
    assert path[cell(plan, 1, 1)] == 0
    assert np.isinf(path[cell(plan, 4.0, 0.5)])


def samples_of(near: np.ndarray, found: np.ndarray, n_houses: int = 100) -> Samples:
    """Return samples of one target (object 0) and its surroundings."""
    n, m = near.shape
    all_found = np.zeros((n, m), np.bool_)
    all_found[:, 0] = found
    return Samples(
        np.arange(n, dtype=np.int32) % n_houses,
        near,
        near,
        np.zeros((n, m), np.bool_),
        np.zeros(n, np.int8),
        np.ones((n, m), np.bool_),
        all_found,
    )


def test_weights_are_found_again():
    rng = np.random.default_rng(0)
    near = rng.random((8000, 4)) < 0.3
    near[:, 0] = False
    odds = -1.0 + near @ np.array([0, 2.0, -1.5, 0])
    samples = samples_of(near, rng.random(8000) < 1 / (1 + np.exp(-odds)))
    fit = learn.cross_fit(samples, 0)
    assert fit is not None
    assert fit.has_opinion
    assert fit.score.auc > 0.7
    weight = fit.beta[:-1]
    assert weight[0] == pytest.approx(0, abs=1e-6)
    assert 0.6 < weight[1] < 2
    assert -1.5 < weight[2] < -0.4
    assert abs(weight[3]) < 0.2
    part = learn.near_part({0: fit}, ("a", "b", "c", "d"))
    assert set(part["weight"]["a"]) >= {"b", "c"}
    for said, true, _ in learn.reliability(samples, {0: fit}, np.array([0.8, 1.2])):
        assert abs(math.log(said)) < abs(math.log(true)) + 0.1  # it is shy, never bold


def test_random_data_gives_no_opinion():
    rng = np.random.default_rng(1)
    samples = samples_of(rng.random((2000, 6)) < 0.3, rng.random(2000) < 0.2)
    fit = learn.cross_fit(samples, 0)
    assert fit is not None
    assert not fit.has_opinion
    assert learn.near_part({0: fit}, tuple("abcdef"))["weight"] == {}


def test_too_few_houses_say_nothing():
    rng = np.random.default_rng(2)
    near = rng.random((500, 3)) < 0.3
    assert learn.cross_fit(samples_of(near, near[:, 1], n_houses=20), 0) is None


@pytest.fixture(scope="module")
def houses(tmp_path_factory):
    """Return houses with a toilet and paper in the bathroom, and a bed in the other room."""
    rng = np.random.default_rng(3)
    file = tmp_path_factory.mktemp("houses") / "houses.jsonl.gz"
    with gzip.open(file, "wt") as lines:
        for _ in range(100):
            x, y = rng.uniform(0.6, 3.4, 2)
            objects = [("toilet", x, y), ("toilet paper", x, y + 0.5), ("bed", x + 4, y)]
            lines.write(json.dumps(house(*objects)) + "\n")
    return file


def test_a_table_is_learned(houses, tmp_path, capsys):
    out = tmp_path / "table.json"
    assert main([str(houses), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "toilet paper" in said
    learned = table.parse(json.loads(out.read_text()))
    assert learned.classes == ("bed", "toilet", "toilet paper")
    assert learned.kinds == ("bathroom", "bedroom")
    assert learned.kind_rooms_with.tolist() == [[0, 100, 100], [100, 0, 0]]
    assert houses.name in json.loads(out.read_text())["source"]
    plan = read_plan(house(("toilet", 1, 1)))
    assert len(starting_cells(plan)) > 500
    samples = gather([plan], learned.classes, learned.kinds)
    assert samples.wanted[:, 0].sum() == 0
    assert len(samples.house) == len(samples.found)
