"""Places in instructions: by name, and by words for the robot's earlier place."""

from __future__ import annotations

import pytest

from edge.config import MissionConfig, parse
from edge.errors import UserError
from edge.geometry import SE2
from edge.memory import Place, RoomName, Site, Zone
from edge.mission.destinations import PlaceTarget
from edge.mission.language.words.places import quote_places
from edge.mission.spec import prepare
from edge.mission.translate import TranslationError

SITE = Site((Place("dock", SE2(1.0, 2.0, 0.0)), Place("loading bay 2", SE2(3.0, 4.0, 0.0))))
NAMES = [place.name for place in SITE.places]


@pytest.mark.parametrize(
    ("instruction", "quoted"),
    [
        ("", ""),
        ("go to the bed", "go to the bed"),
        ("Go to the Dock.", 'Go to "dock".'),
        ("go to the doc\N{KELVIN SIGN}", 'go to "dock"'),
        ("go to loading  bay 2, then the dock", 'go to "loading bay 2", then "dock"'),
        ("go to the docking table", "go to the docking table"),
        ('go to "the dock of the bay"', 'go to "the dock of the bay"'),
        ("find the dock and come back", 'find "dock" and come back'),
        ("patrol the dock and the bed twice", 'patrol "dock" and the bed twice'),
    ],
)
def test_places_are_put_into_quotes(instruction, quoted):
    assert quote_places(instruction, NAMES) == quoted


@pytest.mark.parametrize(
    ("kind", "low_m", "high_m", "refused"),
    [
        ("keep_out", 0.5, 2.5, True),
        ("keep_out", 2.5, 5.0, False),
        ("stay_inside", 0.5, 2.5, False),
        ("stay_inside", 2.5, 5.0, True),
    ],
)
def test_a_place_that_a_zone_closes_is_refused(kind, low_m, high_m, refused):
    corners_m = ((low_m, low_m), (high_m, low_m), (high_m, high_m), (low_m, high_m))
    site = SITE.with_item(Zone("yard", kind, corners_m))
    config = MissionConfig(translator={"kind": "grammar"})
    if not refused:
        assert prepare(config, "go to the dock", site=site).targets == ("dock",)
        return
    with pytest.raises(UserError, match=r"dock is closed by the zone 'yard'; remove the zone or"):
        prepare(config, "go to the dock", site=site)


def briefed(instruction: str):
    return prepare(MissionConfig(translator={"kind": "grammar"}), instruction, site=SITE)


@pytest.mark.parametrize(
    ("instruction", "formula", "places", "prompts"),
    [
        ("go to the dock", "F dock", ["dock"], ("chair",)),
        ("go to the bed, then to the dock", "F (bed & F dock)", ["dock"], ("bed",)),
        ("find the mug and come back", "F (mug & F here)", ["here"], ("mug",)),
        ("go to the loading bay 2 and then return to the start",
         'F ("loading bay two" & F start)', ["loading bay two", "start"], ("chair",)),
        ("explore the house and return to the dock", "F (explored & F dock)",
         ["explored", "dock"], ("chair",)),
        ("patrol the dock and the bed 2 times", "F (dock & F (bed & F (dock & F bed)))", ["dock"],
         ("bed",)),
        ("visit the sofa and the bed", "F sofa & F bed", [], ("sofa", "bed")),
    ],
)  # fmt: skip
def test_a_place_is_a_target_without_a_prompt(instruction, formula, places, prompts):
    spec = briefed(instruction)
    assert str(spec.automaton.formula) == formula
    assert list(spec.translation.destinations) == places
    assert spec.prompts == prompts
    assert spec.translation.instruction == instruction
    assert '"' not in spec.translation.english.replace('"loading bay two"', "")


@pytest.mark.parametrize(
    ("instruction", "labels"),
    [
        ("go to the dock", {"dock": "dock"}),
        ("find the couch in the kitchen", {"couch in the kitchen": "couch"}),
        ("find all chairs", {"every chair": "chair"}),
        ("find all chairs next to the desk, then go to the dock",
         {"every chair next to the desk": "chair", "dock": "dock"}),
        ("check if there is a mug in the kitchen, then go to the dock",
         {"check mug in the kitchen": "mug", "dock": "dock"}),
    ],
)  # fmt: skip
def test_each_target_has_the_label_of_its_detections(instruction, labels):
    spec = briefed(instruction)
    assert spec.labels == labels
    assert next(spec.prompt_for(target) for target in spec.targets) in spec.prompts


def test_a_pose_that_is_not_known_yet_is_left_open():
    found = briefed("go to the dock, then return to the start").translation.destinations
    assert found == {"dock": PlaceTarget(SE2(1.0, 2.0, 0.0)), "start": PlaceTarget()}


@pytest.mark.parametrize(
    "instruction",
    ["go to the dock, then frobnicate the chair", "go to the chair, then frobnicate the dock"],
)
def test_an_unknown_word_is_reported_at_its_position(instruction):
    position = instruction.index("frobnicate") + 1
    with pytest.raises(TranslationError, match=f"character {position}: ") as error:
        briefed(instruction)
    assert error.value.position == position


def test_a_file_of_places_needs_a_frame_that_lasts():
    data = {"perception": {"detector": {"kind": "sim"}}, "mission": {"site": "a.geojson"}}
    with pytest.raises(UserError, match=r"mission\.site: .*set source\.localised to true"):
        parse(data)
    assert parse({**data, "source": {"kind": "zenoh", "localised": True}}).mission.site


@pytest.mark.parametrize(
    ("instruction", "formula", "prompts"),
    [
        ("go to the den", "F den", ("chair",)),
        ("find the mug in the den", 'F "mug in the den"', ("mug",)),
        ("look for the mug in the den, then go to the dock", 'F ("mug in the den" & F dock)',
         ("mug",)),
        ("explore the den", 'F "explored den"', ("chair",)),
        ("find the mug in the crypt", "", ()),
        ('go to "mug on desk in crypt"', "", ()),
    ],
)  # fmt: skip
def test_an_object_may_be_in_a_named_room(instruction, formula, prompts):
    site, config = SITE.with_item(RoomName("den", (4.0, 2.0))), MissionConfig()
    if not formula:
        with pytest.raises(
            UserError, match=r"no room or object is called 'crypt'|'crypt': not a known"
        ):
            prepare(config, instruction, site=site)
        return
    brief = prepare(config, instruction, site=site)
    assert (str(brief.automaton.formula), brief.prompts) == (formula, prompts)
