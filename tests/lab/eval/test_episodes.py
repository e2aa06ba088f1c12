"""Plan of the episodes, and the file that holds them."""

from __future__ import annotations

import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated import simulated
from small_house import small_house

from edge.errors import UserError
from edge.lab.eval import episodes, world_list
from edge.lab.eval.episodes import COMMON_TARGETS, Episode, make_episode, plan, read, write
from edge.lab.eval.questions import plan_questions
from edge.lab.eval.sessions import plan_sessions

HOUSE = simulated()


def test_episodes_are_seeded_free_and_far():
    planned = plan(HOUSE, [], ["television", "bed"], 2, 0, 2.0)
    assert [e.target for e in planned] == ["television"] * 2 + ["bed"] * 2
    assert all(e.shortest_m >= 2.0 for e in planned)
    assert planned == plan(HOUSE, [], ["television", "bed"], 2, 0, 2.0)
    assert planned != plan(HOUSE, [], ["television", "bed"], 2, 1, 2.0)
    assert len({e.id for e in planned}) == 4


def test_starts_that_are_missing_are_reported(caplog):
    planned = plan(HOUSE, [], ["bed"], 20, 0, 11.0)
    assert 0 < len(planned) < 20
    assert f"only {len(planned)} of 20 starts are 11 m or more" in caplog.text


def test_a_start_too_near_is_reported():
    with pytest.raises(UserError, match="no world has a start 500 m or more of driving"):
        plan(HOUSE, [], ["bed"], 1, 0, 500.0)


def test_a_target_that_the_only_world_lacks_is_reported():
    with pytest.raises(UserError, match=r"nothing is a 'bedd' .choices: .*bed, "):
        plan(HOUSE, [], ["television", "bedd"], 1, 0, 2.0)


@pytest.mark.parametrize("kind", ["targets", "missions", "goals", "questions"])
def test_worlds_beyond_the_limit_are_not_loaded(tmp_path, monkeypatch, kind):
    loaded = []
    load = world_list.load
    monkeypatch.setattr(world_list, "load", lambda config: loaded.append(1) or load(config))
    given = small_house(tmp_path), [small_house(tmp_path).sim.world.model_dump()] * 3
    given += (["bed", "sofa"],)
    planned = {
        "targets": lambda: plan(*given, 1, 0, 2.0, limit=1),
        "missions": lambda: episodes.plan_missions(*given, 1, 0, 1.0, limit=1),
        "goals": lambda: plan_sessions(*given, 2, 0, 1.0, limit=1),
        "questions": lambda: plan_questions(*given, 0, limit=1),
    }[kind]()
    assert (len(planned), len(loaded)) == (1, 1)


def blocked(tmp_path, **sim):
    """Return a house whose own start is in a sofa."""
    corners = [(0, 0), (8, 0), (8, 6), (0, 6)]
    walls = [
        {"start": a, "end": b} for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    objects = [{"category": "sofa", "at": [1, 3]}, {"category": "bed", "at": [7, 3]}]
    house = {"name": "blocked", "start": [1, 3, 0], "walls": walls, "objects": objects}
    house["rooms"] = [{"name": "hall", "rect": [0, 0, 8, 6]}]
    path = tmp_path / "blocked.json"
    path.write_text(json.dumps(house))
    world = {"kind": "house", "house": str(path)}
    return simulated({"sim": {"world": world, **sim}})


def test_a_world_with_a_blocked_start_is_skipped_and_reported(tmp_path, caplog):
    worlds = [blocked(tmp_path).sim.world.model_dump(), {"kind": "house", "house": "demo"}]
    planned = plan(HOUSE, worlds, ["bed"], 1, 0, 2.0)
    assert [e.world["house"] for e in planned] == ["demo"]
    assert "evaluation goes on without this world: world blocked: the robot " in caplog.text


def test_each_world_gets_episodes_for_targets_it_has(tmp_path):
    small = small_house(tmp_path).sim.world.model_dump()
    worlds = [{"kind": "house", "house": "demo"}, small]
    planned = plan(HOUSE, worlds, ["bed", "television", "sofa"], 1, 0, 2.0)
    by_world = {name: [e.target for e in planned if e.id.startswith(name)] for name in "ds"}
    assert by_world["d"] == ["bed", "television", "sofa"]
    assert by_world["s"] == ["bed", "sofa"]  # it has no television
    assert {e.world["house"] for e in planned} == {"demo", small["house"]}
    with pytest.raises(UserError, match=r"no world has a start .* from one of the targets"):
        plan(HOUSE, worlds, ["bathtub", "bed"], 1, 0, 90.0)


def test_a_fixed_number_of_episodes_is_drawn_per_world(tmp_path):
    worlds = [{"kind": "house", "house": "demo"}]
    whole = plan(HOUSE, worlds, COMMON_TARGETS, 1, 0, 2.0)
    drawn = plan(HOUSE, worlds, COMMON_TARGETS, 1, 0, 2.0, per_world=3)
    assert len(drawn) == 3 < len(whole)
    assert [e for e in whole if e in drawn] == drawn
    assert drawn == plan(HOUSE, worlds, COMMON_TARGETS, 1, 0, 2.0, per_world=3)


def test_missions_are_planned_in_each_world():
    worlds = [{"kind": "generated", "seed": seed} for seed in (3, 4)]
    config = simulated()
    targets = ("bed", "sofa", "toilet", "oven", "unicorn")
    planned = episodes.plan_missions(config, worlds, targets, 3, 0, 4.0)
    assert planned == episodes.plan_missions(config, worlds, targets, 3, 0, 4.0)
    assert [episode.world["seed"] for episode in planned] == [3, 3, 3, 4, 4, 4]
    assert len({episode.id for episode in planned}) == 6
    for episode in planned:
        assert episode.target is None
        assert episode.instruction.startswith("Reach")
        assert episode.shortest_m >= 4.0
        assert "unicorn" not in episode.instruction
    with pytest.raises(UserError, match="no world has a mission to two targets"):
        episodes.plan_missions(config, [], ["unicorn"], 3, 0, 4.0)


def test_the_sensors_belong_to_an_episode_and_its_id():
    (here,) = plan(HOUSE, [], ["bed"], 1, 0, 2.0)
    wide = simulated({"sensors": {"camera": {"hfov_deg": 100}}})
    (there,) = plan(wide, [], ["bed"], 1, 0, 2.0)
    assert (here.start, here.sensing["sensors"]["camera"]["hfov_deg"]) == (there.start, 75.0)
    assert here.id != there.id


# -- files ----------------------------------------------------------------------------------------


numbers = st.floats(-50, 50, allow_nan=False)


@given(
    start=st.tuples(numbers, numbers, numbers),
    target=st.text(min_size=1, max_size=20),
    shortest_m=st.floats(0, 90),
)
def test_written_episodes_are_read_back_unchanged(tmp_path_factory, start, target, shortest_m):
    path = tmp_path_factory.getbasetemp() / "some.jsonl"
    world = {"kind": "house", "house": "demo"}
    some = [
        make_episode(world, "demo", start, shortest_m, {"robot": {}}, target),
        make_episode(world, "demo", start, shortest_m, {}, instruction=f"go to {target}"),
    ]
    write(path, some)
    assert read(path) == some


EPISODE = {
    "id": "a", "world": {"kind": "house"}, "start": [0, 0, 0], "target": "bed",
    "instruction": None, "shortest_m": 3.0, "sensing": {},
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": [0, 0]}, "line 1: not an episode"),
        ({"target": None}, "line 1: not an episode: target or instruction"),
        ({"shortest_m": -1}, "shortest_m: Input should be greater"),
        ({"world": "demo"}, "world: Input should be a valid dictionary"),
    ],
)
def test_invalid_episode_lines_are_refused(tmp_path, change, message):
    path = tmp_path / "some.jsonl"
    path.write_text(json.dumps({**EPISODE, **change}))
    with pytest.raises(UserError, match=message):
        read(path)


def test_unusable_episode_files_are_refused(tmp_path):
    with pytest.raises(UserError, match=r"nowhere.jsonl: .*--plan FILE` writes"):
        read(tmp_path / "nowhere.jsonl")
    path = tmp_path / "twice.jsonl"
    path.write_text(2 * (json.dumps(EPISODE) + "\n"))
    with pytest.raises(UserError, match="two episodes have the same id a"):
        read(path)
    path.write_text("{")
    with pytest.raises(UserError, match="line 1: not an episode: not JSON"):
        read(path)


def test_an_episode_sets_mission_and_start_of_the_configuration():
    there = Episode("a", {}, (1.0, 2.0, 0.5), "bed", None, 3.0)
    assert there.settings["mission"]["target"] == "bed"
    assert there.settings["mission"]["instruction"] is None
    with_text = Episode("a", {}, (1.0, 2.0, 0.5), None, "go to the bed", 3.0)
    assert with_text.settings["mission"]["instruction"] == "go to the bed"
    assert with_text.settings["sim"]["start"] == [1.0, 2.0, 0.5]


# -- lists of worlds ------------------------------------------------------------------------------


def houses(tmp_path, count: int):
    path = tmp_path / "some.jsonl"
    path.write_text("".join(json.dumps({"name": f"house-{k}"}) + "\n" for k in range(count)))
    return path


@pytest.mark.parametrize(
    ("ranged", "chosen"),
    [("", [0, 1, 2, 3]), ("[1:3]", [1, 2]), ("[2:]", [2, 3]), ("[:2]", [0, 1]), ("[3]", [3])],
)
def test_houses_of_a_file_are_chosen_by_their_places(tmp_path, ranged, chosen):
    path = houses(tmp_path, 4)
    found = world_list.world_sections([f"{path}{ranged}"])
    assert found == [{"kind": "procthor", "file": str(path), "name": f"house-{k}"} for k in chosen]


def test_other_worlds_have_forms_of_their_own():
    named = ["generated[5:7]", "house:demo", "a.glb,b.json"]
    assert world_list.world_sections(named) == [
        {"kind": "generated", "seed": 5},
        {"kind": "generated", "seed": 6},
        {"kind": "house", "house": "demo"},
        {"kind": "mesh", "mesh": "a.glb", "objects": "b.json"},
    ]


@pytest.mark.parametrize(
    ("spec", "error"),
    [
        *((spec, "no such world") for spec in ("demo", "generated", "a.glb", "a.glb,", "house:")),
        ("generated[3:]", "END must be greater than FIRST"),
        ("furnished[5:3]", "END must be greater than FIRST"),
        ("furnished[:200000]", "200000 worlds; at most 100000 are allowed"),
    ],
)
def test_an_invalid_world_list_is_refused(spec, error):
    with pytest.raises(UserError, match=f"--worlds {re.escape(spec)}: .*{error}"):
        world_list.world_sections([spec])


def test_a_range_beyond_a_file_is_refused(tmp_path):
    with pytest.raises(UserError, match="has houses 0 to 1"):
        world_list.world_sections([f"{houses(tmp_path, 2)}[5:9]"])
