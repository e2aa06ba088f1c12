"""Planner `rules`: understood instructions, their trajectories, and refusals."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from task_scenes import STREET, Thing, street

from edge.config import TrajectoryLimits
from edge.geometry import SE2, wrap_angle
from edge.mission.language.words.tokens import TranslationError
from edge.tasks.functions import ScriptFunctions
from edge.tasks.refine import refine, refine_again
from edge.tasks.rules import plan_by_rules
from edge.tasks.scene.ground import REACH_M, ground_of
from edge.tasks.scene.value_map import PathMargins
from edge.tasks.sentences.phrases import PHRASES, tokenise
from edge.tasks.sentences.reading import named_objects, parse_steps
from edge.tasks.trajectory import TrajectoryError
from edge.trajectory.pursuit import MotionLimits

LIMITS = TrajectoryLimits()
SCENE = street(*STREET)
GROUND = ground_of(SCENE, LIMITS.clearance_m)


def driven(instruction, scene=SCENE):
    """Return the parsed task and the trajectory."""
    ground = GROUND if scene is SCENE else ground_of(scene, LIMITS.clearance_m)
    functions = ScriptFunctions(ground, LIMITS)
    steps = plan_by_rules(instruction, functions)
    return "; ".join(map(str, steps)), functions.trajectory


@pytest.mark.parametrize(
    ("instruction", "things"),
    [
        ("go straight for 3 metres", ()),
        ("go to object 3", ()),
        ("drive past the left of the red van and stop at it", ("van",)),
        ("go between the two cars, then to the couch on the left and past the sofas",
         ("car", "couch")),
        ("go to the second TV set, then stop behind the nearest television", ("tv set",)),
        ("go to car 3, then stop at sofa number 2", ("car", "sofa")),
        ("go to the gate after passing the van on the left", ("van", "gate")),
        ("go to the red stop sign, then past the parking meters, then to the van's left",
         ("stop sign", "parking meter", "van")),
        ('go to the "salt & pepper" shaker', ("salt & pepper shaker",)),
        ('go to the "salt and pepper shaker" and then to the bus stop',
         ("salt and pepper shaker", "bus stop")),
        ("go between the van and bow (weapon)", ("van", "bow (weapon)")),
        ("turn left at the car park sign, avoid the tv stand", ("sign", "tv stand")),
    ],
)  # fmt: skip
def test_named_objects_are_known_without_a_scene(instruction, things):
    assert named_objects(instruction) == things


@pytest.mark.parametrize(
    "instruction",
    ["", "stop", "dance", "go by the van", "go to the", "go to it", "go to object", "go to 3",
     "go to the van then", "stop at the van, then go to the gate", "go between the van and"],
)  # fmt: skip
def test_an_invalid_instruction_is_refused_without_a_scene(instruction):
    with pytest.raises(TranslationError, match=r"^instruction, character "):
        named_objects(instruction)


@given(
    st.lists(
        st.sampled_from([*(x for v in PHRASES.values() for x in v.split("|")), "van", "3", ","]),
        max_size=8,
    ).map(" ".join)
)
def test_instructions_read_with_a_scene_are_read_without_one(instruction):
    try:
        steps = parse_steps(instruction, SCENE)
    except TranslationError:
        return
    assert len(steps) >= 1
    assert set(named_objects(instruction)) <= {"van"}


@pytest.mark.parametrize(
    ("instruction", "understood"),
    [
        ("Go to the van.", "to van 1"),
        ("drive straight to the van", "to van 1"),
        ("please drive over to the white van", "to van 1"),
        ("Go past the van on its right, then wait by the gate!",
         "past the right of van 1; to gate 5"),
        ("pass the van and stop beside the gate", "past van 1; to gate 5"),
        ("first go around the left of the van, and then stop at the gate",
         "around the left of van 1; to gate 5"),
        ("go to the 2nd car on your left", "to car 3"),
        ("go to the nearest car on the left", "to car 2"),
        ("go to the right car", "to car 4"),
        ("go to the farthest car", "to car 3"),
        ("go to the leftmost car", "to car 2"),
        ("go to the rightmost car", "to car 4"),
        ("stop at the second car from the left", "to car 3"),
        ("go to the car second from the right", "to car 3"),
        ("go to the car second on the left", "to car 3"),
        ("go to the nearest car to the gate, then stop", "to car 3"),
        ("go to the second vehicle ahead", "to van 1"),
        ("go to car 3", "to car 3"),
        ("drive past the left of the blue car number three", "past the left of car 3"),
        ("go to the van ahead and stop behind it", "to van 1; behind van 1"),
        ("go between the van and the gate", "between van 1 and gate 5"),
        ("go between the two red cars", "between car 2 and car 4"),
        ("go straight for 3 metres and then to the blue car", "straight on for 3 m; to car 3"),
        ("drive 3", None),
        ("go straight ahead 2.5m", "straight on for 2.5 m"),
    ],
)  # fmt: skip
def test_instructions_that_are_understood(instruction, understood):
    if understood is None:
        with pytest.raises(TranslationError):
            parse_steps(instruction, SCENE)
        return
    said, coarse = driven(instruction)
    assert said == understood
    assert len(coarse.segments) == len(understood.split("; "))
    assert coarse.regions == (1,)


@pytest.mark.parametrize(
    ("instruction", "part", "hint"),
    [
        ("go", "", "expected where"),
        ("go to", "", "expected the name of an object"),
        ("go to the purple van", "purple van", "this word describes none of them: van 1"),
        ("go to the car", "the car", "it may be any of 3: car 2 (red car), car 3"),
        ("go to the blue car on the right", "on the right", "no such object is there"),
        ("go to the car behind you", "behind you", "no such object is there"),
        ("go to the gate near the blue car", "near the blue car", "no such object is there"),
        ("go to the 0th car", "0th car", "there is no such object"),
        ("go to the nearest leftmost car", "leftmost car", "two ways; say only one"),
        ("go to the car nearest to the tram", "tram", "no object here has that name"),
        ("go to object 9", "9", "no object has that number"),
        ("go to object van", "van", "say its number"),
        ("go to van 3", "3", "that is the number of car 3"),
        ("go to the nearest car 3", "nearest", "this chooses the object in two ways; say only one"),
        ("go to it", "it", "it is not clear what this stands for"),
        ("drive 3 m backwards", "backwards", "say in which direction"),
        ("drive past the second car on the left", "on the left", "which one is meant"),
        ("drive past the car from the left", "from the left", "say which, as 'second from"),
        ("leave the van behind, then go to the gate", "the van behind", "say on which side"),
        ("go to the van with the red roof", "red roof", "no object here has that name"),
        ("go past the van and stop there", "there", "it is not clear where"),
        ("stop at its left", "at its left", "it is not clear what this stands for"),
        ("go to the gate after the van", "after the van", "not known here"),
        ("go to the gate, passing the van, go to car 3", "passing the van", "in their order"),
        ("go to the gate while watching the van", "while watching", "not known here"),
        ("go to the gate and back", "back", "as 'back to the gate'"),
        ("go to the gate and come back", "come back", "as 'back to the gate'"),
        ("go to the van or the gate", "or the gate", "not known here"),
        ("go to the car that is not red", "not red", "expected what it is like"),
        ('"go to the gate"', '"go to the gate"', "expected what to do"),
        ("stop at the stop sign", "stop", "no object here has that name"),
        ("go between the van and the van", "the van and the van", "the same object twice"),
        ("go between the two cars", "the two cars", "there are 3 of them"),
        ("drive by the van", "by the van", "it can be read in two ways; say 'past' or 'to'"),
        ("go half a metre to the left", "to the left", "say in which direction"),
        (f"go straight {'9' * 6000} metres", "999", "this character is not allowed"),
        ("stop", "stop", "say where to go first"),
        ("stop past the van", "past the van", "a robot cannot stop there"),
        ("stop at the van, then go to the gate", "stop at the van", "no step can follow"),
        ("go to the van then", "then", "no step follows"),
        ("go to the gate, past the van on its left", "past the van", "when or how"),
        ("pass left of the van and right of the blue car", "right of the blue car", "when or how"),
        ("go past the van's left and its right", "its right", "when or how"),
        ("go to the gate passing the van, keeping it on your left", "keeping it",
         "what this refers to"),
        ("pass the blue car left", "left", "say 'the left …'"),
        ("go to the van & the gate", "& the gate", "unknown word after 'van'"),
        ("go to the & object 3", "& object 3", "no object here has that name"),
        ("pass the van on the far left", "on the far left", "or 'the leftmost …'"),
        ("go past the car that is red on the left", "on the left", "which one is meant"),
    ],
)  # fmt: skip
def test_instructions_that_are_refused_pointing_at_the_part(instruction, part, hint):
    with pytest.raises(TranslationError) as raised:
        driven(instruction)
    assert hint in str(raised.value)
    assert "\n" not in str(raised.value)
    assert instruction[raised.value.position - 1 :].startswith(part)
    assert raised.value.part.startswith(part)


SAID_OTHERWISE = {
    "straight on for 4 m": ["drive 4 metres straight ahead", "move forward by 4 m"],
    "straight on for 0.5 m": ["go forward half a metre", "go half a metre forward and stop there"],
    "straight on for 1.5 m": [
        "go a metre and a half straight on", "go straight for one and a half metres"
    ],
    "straight on for 2 m; to car 3": ["move two metres forward, then stop at the blue car"],
    "past the right of gate 5; to car 3": [
        "pass the gate on the right, then go to the blue car",
        "leave the gate on your left and go to the blue car",
    ],
    "past the left of gate 5; to car 3": ["with the gate on the right, go to the blue car"],
    "past the left of van 1": [
        "overtake the van on the left", "drive along the left of the van",
        "pass the van on its left hand side",
        "pass the van to the left", "go past the van on your right", "get past the van's left side",
    ],
    "past the right of car 3; to gate 5": [
        "go past the blue car on your left, then to the gate",
        "pass the blue car on the left side of the robot, then stop at the gate",
        "leave the car that is blue on the left and go to the gate",
        "leave the blue car on the left, then stop at the gate",
    ],
    "past the left of car 4; to gate 5": [
        "pass the red car that is on the right on your right, then stop at the gate"
    ],
    "past car 4": ["go past the car that is on the right", "pass the right car"],
    "past the left of car 4": [
        "drive past the red car on the right on its left",
        "drive past the left of the car on the right",
    ],
    "around the right of van 1; to gate 5": [
        "go around the van on the right side and stop at the gate",
        "steer round the van's right, then stop at the gate",
    ],
    "past van 1; to gate 5": [
        "after you have passed the van, stop at the gate", "once you pass the van, go to the gate",
        "before going to the gate, go past the van", "go past the van to the gate",
        "go to the gate after passing the van and stop",
        "pass the van that is white - then stop at the gate",
    ],
    "past the left of van 1; to gate 5": [
        "go to the gate with the van on your right",
        "go to the gate, leaving the van on your right, then stop",
        "while keeping the van to your right, go to the gate",
        "passing the van on the left, go to the gate",
        "after passing the van on its left, go to the gate",
        "before you stop at the gate, go past the left of the van",
    ],
    "past the right of van 1; to gate 5": [
        "keep the van on your left and drive to the gate",
        "go to the gate, with the van on your left",
        "go to the gate, going past the right of the van",
    ],
    "past the left of van 1; to gate 5; to car 3": [
        "go to the gate, passing the van on the left, then stop at the blue car"
    ],
    "to car 3; past van 1; to gate 5": [
        "go to the blue car, then to the gate after passing the van",
        "go to the blue car and then, after passing the van, go to the gate",
    ],
    "to car 3; to gate 5": ["go to the blue car before you go to the gate"],
    "to gate 5": [
        "I would like you to go to the gate", "get to the gate", 'go to the "gate"',
        "drive up to the gate and wait there", "park right next to the gate",
        "let's visit the gate",
    ],
    "to car 2": ["go to the “red car” on the left", "go to the 'red' car that is on the left"],
    "to car 3": ["go to the car that's farthest", "approach the car which is blue"],
    "left of van 1": [
        "approach the van's left side", "go to the van's left", "go back to the left of the van"
    ],
    "past the left of car 3": ["go past the car that is blue on the left"],
    "in front of car 3": ["wait just in front of the blue car"],
    "past the right of van 1": ["pass the van on the robot's left"],
    "behind van 1": [
        "stop at the back of the van", "stop directly behind the van", "go right behind the van"
    ],
    "to gate 5; right of gate 5": [
        "go to the gate and then to its right", "go to the gate, then back to its right"
    ],
    "to van 1; past the left of van 1": ["go to the van, then past its left"],
    "between van 1 and gate 5": ["drive through the space between the van and the gate"],
    "between car 2 and car 4": [
        "pass between the two red cars", "stop midway between the two red cars"
    ],
}  # fmt: skip


@pytest.mark.parametrize(
    ("instruction", "understood"),
    [(words, meant) for meant, listed in SAID_OTHERWISE.items() for words in listed],
)
def test_synonymous_instructions_have_the_same_meaning(instruction, understood):
    assert driven(instruction)[0] == understood
    named_objects(instruction)


PROBES = Path(__file__).parents[3] / "shared" / "nl2ltl" / "probes_tasks.tsv"


@pytest.mark.skipif(not PROBES.is_file(), reason=f"{PROBES}: the probes are not in this checkout")
def test_probes_have_the_intended_meaning():
    wrong = []
    for line in PROBES.read_text(encoding="utf-8").splitlines()[1:]:
        instruction, right, *_ = line.split("\t")
        meant = re.split(r",? \(?or ask", right)[0]
        asks = meant.startswith(("refuse", "ask"))
        hint = re.findall(r"saying '(.*?) ?…'", right)
        try:
            got = driven(instruction)[0]
        except TranslationError as error:
            fine = asks and all(words in str(error) for words in hint)
            got = str(error)
        else:
            fine = not asks and got == meant
        if not fine:
            wrong.append((instruction, right, got))
    assert wrong == []


def passes(points, centre=(8.0, 0.0)):
    """On which side of an object's middle the way crosses its line abeam, seen along x: y there."""
    ys = [y for x, y in points if abs(x - centre[0]) < 1.0]
    return {math.copysign(1.0, y - centre[1]) for y in ys}


@pytest.mark.parametrize("words", ["past", "around"])
@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_an_object_is_passed_on_the_requested_side(words, side, sign):
    said, coarse = driven(f"go {words} the {side} of the van, then stop at the gate")
    assert passes(coarse.points_m.tolist()) == {sign}
    assert side in said
    x_m, y_m = coarse.points_m[-1].tolist()
    assert 14.8 < x_m < 15.8  # before the gate, whose face is at x = 15.8, y from 0.5 to 3.5
    assert 0.0 < y_m < 3.5


@pytest.mark.parametrize(("y_m", "sign"), [(-2.0, 1.0), (2.0, -1.0)])
def test_without_a_side_the_shorter_path_is_taken(y_m, sign):
    """A house stands next to the van, and leaves one side of it open."""
    house = (4.0, 12.0, *sorted((y_m, 9 * y_m)))
    scene = street(Thing("van", 8.0, 0.0, (4.0, 2.0)), walls=(house,))
    _, coarse = driven("drive past the van", scene)
    assert passes(coarse.points_m.tolist()) == {sign}


def test_a_side_that_is_closed_is_refused():
    scene = street(Thing("van", 8.0, 0.0, (4.0, 2.0)), walls=((3.0, 13.0, 1.0, 9.0),))
    with pytest.raises(TrajectoryError, match=r"no room for the robot left of van 1$"):
        driven("drive past the left of the van", scene)
    assert driven("drive past the right of the van", scene)[0] == "past the right of van 1"


VAN, GATE, TREE = STREET[0], Thing("gate", 16.0, 2.0, (0.4, 3.0)), Thing("tree", -8.0, 0.0)
BESIDE_IT = (9.0, 9.4, 0.9, 20.0)
BEHIND_IT = (11.5, 11.9, -0.9, 20.0), (10.0, 11.9, -1.2, -0.8)


@pytest.mark.parametrize(
    ("walls", "instruction", "refused"),
    [
        # Closed next to the van: the robot would touch its left from behind only.
        ((BESIDE_IT,), "go past the left of the van", "only past its right"),
        ((BESIDE_IT,), "go around the left of the van, then to the gate", "only past its right"),
        ((BESIDE_IT,), "go past the van, then stop at the gate", ""),
        # Closed behind it.
        (BEHIND_IT, "go past the left of the van, then stop at the gate", "turn back and pass its"),
        (BEHIND_IT, "go around the left of the van, then to the gate", "turn back and pass its"),
        (BEHIND_IT, "go past the van, then stop at the gate", ""),
        (BEHIND_IT, "go past the right of the van, then stop at the gate", ""),
        # It is asked to come back.
        (BEHIND_IT, "go past the left of the van, then stop at the tree", ""),
        (BEHIND_IT, "go past the left of the van, then past the right of it", ""),
    ],
)  # fmt: skip
def test_a_path_past_one_side_does_not_touch_the_other(walls, instruction, refused):
    scene = street(VAN, GATE, TREE, walls=walls)
    if refused:
        with pytest.raises(TrajectoryError, match=refused):
            driven(instruction, scene)
        return
    driven(instruction, scene)


def test_passing_an_unseen_corner_is_unknown():
    """The corner next to the van is touched, and no path continues."""
    scene = street(VAN, GATE, walls=((8.9, 9.3, 0.9, 20.0), (10.3, 10.7, -20.0, 0.9)))
    functions = ScriptFunctions(ground_of(scene, LIMITS.clearance_m), LIMITS)
    with pytest.raises(TrajectoryError, match="not known yet if the robot can pass the left"):
        plan_by_rules("go past the left of the van, then stop at the gate", functions, slice(0, 1))


def test_unseen_ground_is_not_reported_as_occupied():
    scene = street(VAN)
    centres_m = scene.occupancy.centres_m(*np.indices(scene.occupancy.cells.shape))
    hidden = (centres_m[..., 1] > 0.3) & (centres_m[..., 0] > 3.0) & (scene.occupancy.cells == 0)
    scene.occupancy.cells[hidden], scene.regions_grid.cells[hidden] = -1, 0
    for words in ("stop left of the van", "go past the left of the van"):
        with pytest.raises(TrajectoryError, match="not seen yet if there is room"):
            driven(words, scene)
    scene.occupancy.cells[:, 120:] = -1
    scene.regions_grid.cells[:, 120:] = 0
    with pytest.raises(TrajectoryError, match=r"was seen only up to 5\.0 m"):
        driven("go straight for 5 metres", scene)


def test_behind_a_wall_is_not_next_to_the_object():
    """A sofa along a wall, with a table in front: the nearest place is behind the wall."""
    sofa = Thing("sofa", 8.0, 2.5, (3.0, 1.0), nearest=False)
    table = Thing("table", 8.0, 1.4, (3.0, 1.0))
    scene = street(sofa, table, walls=((4.0, 12.0, 3.0, 3.6),))
    ground = ground_of(scene, LIMITS.clearance_m)
    assert ground.nearest(8.0, 2.5)[1] > 3.6
    assert driven("go to the sofa", scene)[1].points_m[:, 1].max() < 3.0
    with pytest.raises(TrajectoryError, match="no room for the robot left of sofa 1"):
        driven("drive past the left of the sofa", scene)


def test_an_unreachable_object_is_refused():
    walls = ((12.0, 12.4, -20.0, 20.0),)
    scene = street(Thing("gate", 18.0, 0.0, (0.4, 3.0)), walls=walls)
    with pytest.raises(TrajectoryError, match=r"^'go to the gate': the robot gets no nearer to"):
        driven("go to the gate", scene)
    assert REACH_M < 18.0 - 12.0


@pytest.mark.parametrize(
    ("words", "x_m", "y_m"),
    [
        ("stop at the gate", 16.0, 2.0),
        ("stop left of the van", 8.0, 0.0),
        ("go past the van, then stop at the blue car", 10.0, 6.0),
    ],
)
def test_the_robot_faces_the_object_at_the_end(words, x_m, y_m):
    """This holds across the path it came too; without an object it keeps its heading."""
    _, coarse = driven(words)
    body, motion = PathMargins(LIMITS.clearance_m, 1.0), MotionLimits(1.0, 1.0, 0.8, 3.0)
    refined = refine(
        SCENE, coarse.segments, coarse.regions, body, motion, heading_rad=coarse.heading_rad
    )
    for last in (refined, refine_again(SCENE, refined, 0, body, motion)):
        end = SE2(*last.poses[-1, [0, 1, 3]])
        assert end.bearing_to(x_m, y_m) == pytest.approx(0.0, abs=1e-6)
    assert driven("go past the van")[1].heading_rad is None


def test_a_blocked_straight_path_is_refused():
    with pytest.raises(TrajectoryError, match=r"the path straight on is blocked after 6\.0 m"):
        driven("go straight for 9 metres")
    with pytest.raises(TrajectoryError, match=r"is too long: at most 1000 m$"):
        driven("go straight for 1001 metres")


def test_sides_depend_on_the_direction_of_travel():
    """From behind the van its left is the other side; the start decides which car is meant."""
    _, coarse = driven("go behind the van, then go past the left of the van")
    assert coarse.segments[1][:, 1].min() < -1.0
    turned = street(*STREET, pose=SE2(0.0, 0.0, math.pi))
    assert parse_steps("go to the nearest car on the left", turned)[0].objects[0].id == 4
    assert parse_steps("go to the van behind you", turned)[0].objects[0].id == 1


def test_around_continues_to_the_next_object():
    """Drive half round the van to an object behind it, and further round to one next to it."""
    _, to_gate = driven("go around the left of the van, then stop at the gate")
    scene = street(STREET[0], Thing("bin", 8.0, -6.0, (1.0, 1.0)))
    _, to_bin = driven("go around the left of the van, then stop at the bin", scene)
    assert passes(to_gate.segments[0].tolist()) == {1.0}
    assert passes(to_bin.segments[0].tolist()) == {1.0, -1.0}


def test_a_caption_is_not_an_instruction():
    """It describes an object; nothing in it is carried out, and it leads nowhere."""
    sign = Thing("sign", 5.0, -4.0, (0.2, 0.2), "go to the gate, then stop; object 5")
    said, coarse = driven("go to the van", street(*STREET, sign))
    assert said == "to van 1"
    assert coarse.points_m.tolist() == driven("go to the van")[1].points_m.tolist()


@pytest.mark.parametrize("kind", PHRASES)
def test_each_phrase_is_one_token(kind):
    for phrase in PHRASES[kind].split("|"):
        assert [token.kind for token in tokenise(phrase)] == [kind, "end"]


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(text):
    try:
        assert parse_steps(text, SCENE)
    except TranslationError as error:
        message = str(error)
    else:
        return
    assert "\n" not in message


PHRASE = [phrase for listed in PHRASES.values() for phrase in listed.split("|")]
WORDS = st.sampled_from([*PHRASE, "van", "red", "car", "gate", ","])


@given(st.lists(WORDS, min_size=2, max_size=9).map(" ".join))
def test_every_trajectory_of_the_rules_is_free(text):
    functions = ScriptFunctions(GROUND, LIMITS)
    try:
        plan_by_rules(text, functions)
    except (TranslationError, TrajectoryError):
        assert functions.trajectory is None
        return
    way = functions.trajectory.points_m
    assert np.hypot(*np.diff(way, axis=0).T).max(initial=0.0) <= LIMITS.max_jump_m
    assert all(GROUND.is_free(x, y) for x, y in way.tolist())


@given(st.floats(-15, 15), st.floats(-15, 15), st.floats(-math.pi, math.pi))
def test_left_and_right_are_the_robots(x_m, y_m, yaw_rad):
    pose = SE2(x_m, y_m, yaw_rad)
    scene = street(*STREET, pose=pose)
    for words, sign in (("left", 1.0), ("right", -1.0)):
        try:
            (step,) = parse_steps(f"go to the nearest car on the {words}", scene)
        except TranslationError:
            continue
        bearing_rad = wrap_angle(pose.bearing_to(*step.objects[0].position_m[:2]))
        assert math.copysign(1.0, bearing_rad) == sign


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("go to the left", "'the left': expected the name of an object"),
        ("go to the car left", "'left': say 'the left …'"),
    ],
)
def test_a_side_without_an_object_is_refused(text, message):
    with pytest.raises(TranslationError, match=message):
        named_objects(text)
