"""Free sentences: each is read as it is meant, or refused."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from task_scenes import Thing, street

from edge.config import TrajectoryLimits
from edge.geometry import wrap_angle
from edge.mission.language.words.tokens import TranslationError
from edge.tasks.functions import ScriptFunctions
from edge.tasks.manoeuvres import AVOID_M
from edge.tasks.refine import refine
from edge.tasks.rules import plan_by_rules
from edge.tasks.scene.ground import ground_of
from edge.tasks.scene.scene import Region
from edge.tasks.scene.value_map import PathMargins
from edge.tasks.sentences.reading import parse_steps, task_steps
from edge.tasks.sentences.steps import describe_steps
from edge.tasks.trajectory import TrajectoryError
from edge.trajectory.pursuit import MotionLimits

SENTENCES = Path(__file__).with_name("sentences.tsv")
REGIONS = {"sidewalk": -3.0, "road": 3.0, "lawn": 8.0, "parking": -20.0}
"""Label of a strip of ground along x → its smallest y."""


def square():
    """Return a street with named ground, whose objects fit the sentences."""
    scene = street(
        Thing("van", 8.0, 0.0, (4.0, 2.0), "white van"),
        Thing("car", 4.0, 5.0, (3.0, 1.6), "red car"),
        Thing("car", 10.0, 6.0, (3.0, 1.6), "black car"),
        Thing("car", 6.0, -5.0, (3.0, 1.6), "grey car"),
        Thing("gate", 16.0, 2.0, (0.4, 3.0), "iron gate"),
        Thing("tree", 2.0, -8.0, (1.0, 1.0), "tall tree"),
        Thing("tree", 14.0, -7.0, (1.0, 1.0), "small tree"),
        Thing("bench", 12.0, 12.0, (1.5, 0.6), "wooden bench"),
        Thing("stop sign", 14.0, -4.0, (0.4, 0.4), "red stop sign"),
        Thing("bus stop", -6.0, -6.0, (3.0, 1.0), "bus stop"),
        Thing("fence", -2.0, 9.0, (10.0, 0.4), "black fence"),
        Thing("house", 16.0, -14.0, (4.0, 4.0), "white house"),
        Thing("house", -10.0, 14.0, (4.0, 4.0), "brick house"),
        Thing("trash can", -8.0, 4.0, (0.6, 0.6), "green trash can"),
        Thing("person", 4.0, -2.0, (0.4, 0.4), "man"),
        Thing("building", -14.0, -12.0, (4.0, 4.0), "cylindrical building"),
        Thing("car", 9.0, -11.0, (3.0, 1.6), "white car, blue pattern on the door"),
    )
    grid = scene.regions_grid
    y_m = grid.centres_m(*np.indices(grid.cells.shape))[..., 1]
    cells = np.zeros_like(grid.cells)
    for label in sorted(REGIONS, key=lambda name: REGIONS[name]):
        cells[y_m >= REGIONS[label]] = list(REGIONS).index(label) + 1
    regions = {k: Region(k, label, 100.0) for k, label in enumerate(REGIONS, 1)}
    return replace(scene, regions=regions, regions_grid=replace(grid, cells=cells))


SCENE, LIMITS = square(), TrajectoryLimits()
GROUND = ground_of(SCENE, LIMITS.clearance_m)


ROWS = [tuple(line.split("\t")) for line in SENTENCES.read_text(encoding="utf-8").splitlines()[1:]]


def outcome(instruction, meanings):
    """Return the result and the reading, or the error.

    "right", "wrong", "refused" (it has a meaning), or "asked" (it has none, and is refused).
    """
    try:
        read = describe_steps(parse_steps(instruction, SCENE))
    except TranslationError as error:
        one_line = error.part in instruction and "\n" not in str(error)
        refused = "asked" if meanings[0] == "ask" else "refused"
        return refused if one_line else "wrong", str(error)
    return "right" if read in meanings else "wrong", read


def test_an_empty_sentence_is_refused():
    with pytest.raises(TranslationError, match="say where to go"):
        parse_steps("", SCENE)


def test_no_sentence_is_read_wrong_and_most_are_read():
    counts, wrong = Counter(), []
    for group, instruction, meaning in ROWS:
        found, read = outcome(instruction, meaning.split(" / "))
        counts[group, found] += 1
        wrong += [(instruction, read)] * (found == "wrong")
    print(*sorted(counts.items()), sep="\n")  # pytest -s: the table of docs/experiments.md
    assert wrong == []
    assert counts["free", "right"] >= 40
    assert counts["fresh", "right"] >= 28
    assert counts["last", "right"] >= 16
    assert counts["paper", "right"] >= 6


@pytest.mark.parametrize(
    ("instruction", "read"),
    [
        ("advance to the gate", "to gate 5"),
        ("cross over to the other side of the road", "across road"),
        ("go to the gate without driving over the grass", "avoid lawn; to gate 5"),
        ("go to the gate, but stay away from the fence", "avoid fence 11; to gate 5"),
        ("drive to a point halfway between the gate and the van", "between gate 5 and van 1"),
    ],
)
def test_more_words_for_the_same(instruction, read):
    assert describe_steps(parse_steps(instruction, SCENE)) == read


@pytest.mark.parametrize("instruction", [row[1] for row in ROWS])
def test_instructions_read_with_a_scene_are_read_without_one(instruction):
    try:
        steps = parse_steps(instruction, SCENE)
    except TranslationError:
        return
    assert len(task_steps(instruction)) == len(steps)


def driven(instruction):
    """Return the ends of the segments, and the refined trajectory."""
    functions = ScriptFunctions(GROUND, LIMITS)
    plan_by_rules(instruction, functions)
    coarse = functions.trajectory
    refined = refine(
        functions.ground.scene, coarse.segments, coarse.regions, PathMargins(LIMITS.clearance_m),
        MotionLimits(0.5, 1.0, 0.5, 1.0), heading_rad=coarse.heading_rad,
    )  # fmt: skip
    return coarse.segments, refined


@pytest.mark.parametrize(
    ("instruction", "end_m", "heading_deg"),
    [
        ("turn left", (0.0, 0.0), 90.0),
        ("turn around, then go straight for 3 metres", (-3.0, 0.0), 180.0),
        ("go straight for 2 metres and turn right by 30 degrees", (2.0, 0.0), -30.0),
        ("go straight for 1 metre, turn around, then go straight for 2 m", (-1.0, 0.0), 180.0),
        ("stop 2 metres before the gate", (13.8, 0.5), None),
        ("stop 2 metres behind the van", (12.0, 0.0), None),
        ("go onto the grass", (0.0, 8.5), None),
        ("cross the road", (0.0, 8.5), None),
        ("go straight until you reach the van", (5.5, 0.0), 0.0),
        ("follow the fence, then go to the trash can", (-7.5, 4.7), None),
    ],
)
def test_steps_end_at_the_expected_pose(instruction, end_m, heading_deg):
    _, refined = driven(instruction)
    x_m, y_m, _, heading_rad = refined.poses[-1].tolist()
    assert math.dist((x_m, y_m), end_m) < 0.35
    if heading_deg is not None:
        assert abs(wrap_angle(heading_rad - math.radians(heading_deg))) < 0.05


@pytest.mark.parametrize(("sense", "sign"), [("clockwise", -1.0), ("counterclockwise", 1.0)])
def test_a_circle_is_a_full_turn_in_the_requested_direction(sense, sign):
    _, refined = driven(f"circle the van {sense}")
    x, y = (refined.poses[:, :2] - (8.0, 0.0)).T
    turned_rad = np.unwrap(np.arctan2(y, x))
    assert sign * (turned_rad[-1] - turned_rad[0]) > math.radians(330)


def test_halfway_is_half_of_the_path():
    (whole,), _ = driven("go to the bench")
    (half,), _ = driven("go halfway to the bench")
    length_m = [np.hypot(*np.diff(points, axis=0).T).sum() for points in (whole, half)]
    assert length_m[1] == pytest.approx(0.5 * length_m[0], abs=0.01)


def test_along_an_object_keeps_to_its_side():
    (along, _), _ = driven("drive along the fence to the trash can")
    beside = along[along[:, 1] > 6.0]
    assert (beside[:, 1] < 8.0).all()  # the near face of the fence is at y = 8.8


def test_avoided_objects_are_kept_at_a_distance():
    grey = GROUND.outline(SCENE.objects[4])
    near_m, away_m = (
        grey.gaps_m(driven(f"go to object 17{avoiding}")[1].poses[:, :2]).min()
        for avoiding in ("", " but avoid the grey car")
    )
    assert near_m < AVOID_M < away_m


def test_the_ground_to_keep_to_is_preferred():
    _, refined = driven("keep to the sidewalk and go to the gate")
    assert np.abs(refined.poses[:, 1]).max() < 3.0
    assert refined.drivable == {1}


@pytest.mark.parametrize(
    ("instruction", "part", "hint"),
    [
        ("go onto the square", "square", "no ground here has that name; there is sidewalk"),
        ("follow the man", "man", "this cannot be followed"),
        ("follow the tree near the stop sign", "tree", "this cannot be followed"),
        ("turn back to the gate", "to the gate", "not known here"),
        ("run into the van", "the van", "expected a kind of ground"),
        ("avoid the van and the gate", "the gate", "expected what to do"),
        ("stop at the gate, avoid the van, then go to the bench", "stop at", "no step can follow"),
        ("bring me the bench", "the bench", "expected where"),
        ("turn", "", "say to which side"),
        ("turn left by 400 degrees", "400 degrees", "at most 180"),
        ("go to the van, turn left, then go to the house on the right", "on the right",
         "after a turn it is not clear which this is"),
        ("go straight, then turn left", "straight", "say how far"),
        ("keep to the van", "the van", "say the kind of ground"),
        ("avoid the van", "", "say where to go"),
        ("go around the left of the van clockwise", "clockwise", "the side is said twice"),
        ("stop 2 metres", "", "say in which direction"),
        ("wait at the bus", "bus", "no object here has that name"),
    ],
)  # fmt: skip
def test_an_unclear_instruction_is_refused_with_the_word(instruction, part, hint):
    with pytest.raises(TranslationError, match=hint) as raised:
        parse_steps(instruction, SCENE)
    assert raised.value.part.startswith(part)


@pytest.mark.parametrize(
    ("instruction", "hint"),
    [
        ("cross the sidewalk", "on the sidewalk already"),
        ("go straight until you are next to the trash can", "not ahead"),
        ("stop 9 metres before the red car", "nearer than 9 m to car 2 already"),
        ("turn left, then follow the fence", "say to what"),
        ("avoid the sidewalk and go to the bench", "stands too near to what it is to avoid"),
    ],
)
def test_an_impossible_step_is_refused_with_the_reason(instruction, hint):
    with pytest.raises(TrajectoryError, match=hint):
        driven(instruction)


def test_a_turn_is_joined_to_its_neighbouring_steps():
    steps = task_steps("go to the van, turn left, go straight for 2 metres, then go to the gate")
    assert [step.joined for step in steps] == [False, True, True, False]


def test_avoided_objects_are_needed_from_the_first_step():
    steps = task_steps("go to the gate, then go to the van without going near the bench")
    assert [step.names for step in steps] == [("gate", "bench"), ("van", "bench")]


def test_sides_count_after_the_first_turn():
    ahead, turned = (
        parse_steps(f"{turn}go to the nearest house on the left", SCENE)[-1].objects[0].id
        for turn in ("", "turn around, then ")
    )
    assert (ahead, turned) == (13, 12)
