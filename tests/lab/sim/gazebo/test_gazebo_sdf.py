"""SDF worlds: places of visuals, names, and files that a world may not read."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from gazebo_files import model, visual, write_model, write_world
from hypothesis import given
from hypothesis import strategies as st

from edge.lab.sim.base import WorldError
from edge.lab.sim.gazebo.folders import ModelFolders
from edge.lab.sim.gazebo.naming import object_name, read_names, save_names
from edge.lab.sim.gazebo.sdf import SdfReader


def read(world: Path, *models: Path):
    reader = SdfReader(ModelFolders([world.parent, *models]))
    return reader.read(world), reader.problems


def test_an_empty_world_has_no_visuals(tmp_path):
    assert read(write_world(tmp_path / "a.world", "")) == ([], {})


INCLUDE = "<include><uri>model://Sofa_01</uri>{}</include>"
PLACES = {
    "a model": (model("m", pose="1 2 3 0 0 0"), ("m", "m"), (1, 2, 3)),
    "an included one": (INCLUDE.format("<pose>1 0 0 0 0 0</pose>"), ("Sofa_01",) * 2, (1, 0, 0)),
    "its own pose": (INCLUDE.format(""), ("Sofa_01", "Sofa_01"), (0, 0, 7)),
    "a name": (INCLUDE.format("<name>mine</name>"), ("mine", "Sofa_01"), (0, 0, 7)),
    "wrapped": (
        f"<model name='w'>{INCLUDE.format('')}<pose>1 0 0 0 0 0</pose></model>",
        ("w", "Sofa_01"), (1, 0, 7),
    ),
    "nested": (
        f"<model name='w'><pose>1 0 0 0 0 0</pose><link name='l'/>"
        f"{model('in', pose='0 1 0 0 0 0')}</model>",
        ("w-in", "in"), (1, 1, 0),
    ),
    "one of two": (
        f"<model name='w'>{model('in', pose='0 1 0 0 0 0')}<model name='empty'/></model>",
        ("w-in", "in"), (0, 1, 0),
    ),
    "relative to another link": (
        "<model name='m'><link name='a'><pose>1 0 0 0 0 0</pose></link><link name='b'>"
        "<pose>0 5 0 0 0 0</pose>" + visual(more="<pose relative_to='a'>0 0 2 0 0 0</pose>") +
        "</link></model>",
        ("m", "m"), (1, 0, 2),
    ),
    "relative to the model": (
        "<model name='m'><link name='b'><pose>0 5 0 0 0 0</pose>"
        + visual(more="<pose relative_to='__model__'>0 0 2 0 0 0</pose>") + "</link></model>",
        ("m", "m"), (0, 0, 2),
    ),
    "turned": (
        f"<model name='w'><pose degrees='true'>0 0 0 0 0 90</pose><link name='l'/>"
        f"{model('in', pose='2 0 0 0 0 0')}</model>",
        ("w-in", "in"), (0, 2, 0),
    ),
    "moved in Gazebo": (
        model("m") + "<state><model name='m'><pose>5 0 0 0 0 0</pose></model></state>",
        ("m", "m"), (5, 0, 0),
    ),
    "relative to a frame": (
        "<frame name='f'><pose>4 0 0 0 0 0</pose></frame>"
        + model("m").replace("<link", "<pose relative_to='f'>1 0 0 0 0 0</pose><link", 1),
        ("m", "m"), (5, 0, 0),
    ),
    "a quaternion": (
        model("m").replace(
            "<link", "<pose rotation_format='quat_xyzw'>1 0 0 0 0 1 0</pose><link", 1
        ),
        ("m", "m"), (1, 0, 0),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", PLACES)
def test_visuals_are_placed_and_named(tmp_path, case):
    body, names, xyz = PLACES[case]
    write_model(tmp_path / "models", "Sofa_01", pose="0 0 7 0 0 0")
    found, problems = read(write_world(tmp_path / "w" / "a.world", body), tmp_path / "models")
    assert problems == {}
    assert [(each.instance, each.model) for each in found] == [names]
    assert found[0].T_world_visual[:3, 3] == pytest.approx(xyz)


def turned(x, y, z, roll, pitch, yaw):
    """Return the pose by the definition of SDF: turns about the fixed axes x, y, z."""
    T = np.eye(4)
    for axis, angle in enumerate((roll, pitch, yaw)):
        turn, (i, j) = np.eye(4), [(1, 2), (2, 0), (0, 1)][axis]
        turn[i, i] = turn[j, j] = math.cos(angle)
        turn[j, i], turn[i, j] = math.sin(angle), -math.sin(angle)
        T = turn @ T
    T[:3, 3] = x, y, z
    return T


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 6))
def test_angles_are_roll_pitch_yaw(tmp_path_factory, pose):
    file = tmp_path_factory.getbasetemp() / "angles.world"
    write_world(file, model("m", pose=" ".join(map(str, pose))))
    x, y, z, roll, pitch, yaw = pose
    expected = turned(x, y, z, roll, pitch, yaw)
    assert np.allclose(read(file)[0][0].T_world_visual, expected)


LEFT_OUT = {
    "a model that is not there": (INCLUDE.format(""), "model://Sofa_01 is in no model folder"),
    "a pose of words": (model("m", pose="a b c"), "<pose> is 'a b c'; expected 6 numbers"),
    "no number": (model("m", pose="nan 0 0 0 0 0"), "expected 6 numbers"),
    "no such frame": (
        model("m").replace("<link", "<pose relative_to='f'>0 0 0 0 0 0</pose><link", 1),
        "relative to 'f', which is no link",
    ),
    "a person": ("<actor name='a'/>", "<actor> 'a': left out"),
}


@pytest.mark.parametrize("case", LEFT_OUT)
def test_an_unreadable_model_is_skipped_and_reported(tmp_path, case):
    body, reason = LEFT_OUT[case]
    found, problems = read(write_world(tmp_path / "a.world", body + model("good")))
    assert [each.instance for each in found] == ["good"]
    (problem,) = problems
    assert str(tmp_path) in problem or "<model> 'm'" in problem
    assert reason in problem


def test_a_model_that_includes_itself_ends(tmp_path):
    write_model(tmp_path, "Sofa_01").joinpath("model.sdf").write_text(
        f"<sdf><model name='s'>{INCLUDE.format('')}</model></sdf>"
    )
    found, problems = read(write_world(tmp_path / "a.world", INCLUDE.format("")))
    assert found == []
    assert "nested too deeply" in str(problems)


BOMB = "<!DOCTYPE a [<!ENTITY b 'x'><!ENTITY c '&b;&b;'>]><sdf>&c;</sdf>"
REFUSED = {"no file": None, "no XML": "<sdf", "entities": BOMB}


@pytest.mark.parametrize("case", REFUSED)
def test_a_world_that_cannot_be_used_is_refused(tmp_path, case):
    file = tmp_path / "a.world"
    if REFUSED[case] is not None:
        file.write_text(REFUSED[case])
    with pytest.raises(WorldError, match=r"a\.world") as error:
        read(file)
    assert "\n" not in str(error.value)


OUTSIDE = (
    "../../secret", "model://../secret", "file:///SECRET", "/SECRET", "..\\..\\secret",
    "model://link/secret", "http://host/../../secret", "a\0b", "%2e%2e/secret",
)  # fmt: skip


@pytest.mark.parametrize("uri", OUTSIDE)
def test_nothing_outside_the_folders_is_found(tmp_path, uri):
    models, secret = tmp_path / "a" / "models", tmp_path / "secret"
    models.mkdir(parents=True)
    secret.write_text("secret")
    (tmp_path / "a" / "secret").write_text("secret")
    (models / "link").symlink_to(tmp_path)
    folders = ModelFolders([models])
    uri = uri.replace("/SECRET", str(secret))
    assert folders.find(uri, models) is None
    assert folders.find_texture(uri, models) is None


FOUND = {
    "model://Sofa/meshes/a.obj", "package://Sofa/meshes/a.obj", "meshes/a.obj",
    "file://models/Sofa/meshes/a.obj", "meshes\\a.obj", "file://meshes/a.obj",
    "model://Sofa%20/../Sofa/meshes/a.obj",
}  # fmt: skip


@pytest.mark.parametrize("uri", sorted(FOUND))
def test_uris_of_a_mesh(tmp_path, uri):
    models = tmp_path / "models"
    mesh = models / "Sofa" / "meshes" / "a.obj"
    mesh.parent.mkdir(parents=True)
    mesh.write_text("")
    assert ModelFolders([models]).find(uri, models / "Sofa") == mesh


def test_addresses_of_models_are_looked_up_and_not_fetched(tmp_path):
    write_model(tmp_path / "Sofa", "2")
    folder = write_model(tmp_path / "Sofa", "10")  # the newest version
    uri = "https://fuel.gazebosim.org/1.0/someone/models/Sofa"
    assert ModelFolders([tmp_path]).find_model(uri, tmp_path) == folder / "model.sdf"
    (folder / "new.sdf").write_text("")
    files = "<sdf version='1.5'>model.sdf</sdf><sdf version='1.9'>new.sdf</sdf>"
    (folder / "model.config").write_text(f"<model>{files}</model>")
    assert ModelFolders([tmp_path]).find_model(uri, tmp_path) == folder / "new.sdf"


@pytest.mark.parametrize(
    ("model_name", "name"),
    [
        ("", "structure"),
        ("aws_robomaker_residential_Sofa_01", "sofa"),
        ("aws_robomaker_residential_SofaC_01", "sofa"),
        ("aws_robomaker_hospital_floor_01_walls", "structure"),
        ("RetailShopFloor_01", "structure"),
        ("InstrumentCart1", "instrument cart"),
        ("BedsideTable", "nightstand"),
        ("OfficeChair_2_1", "chair"),
        ("ground_plane", "structure"),
    ],
)
def test_object_names_come_from_model_names(model_name, name):
    assert object_name(model_name) == name


@given(st.dictionaries(st.text("abC_ -:#'\"{}1", min_size=1), st.sampled_from(("sofa", "bed"))))
def test_a_saved_table_of_names_is_read_back(tmp_path_factory, table):
    file = tmp_path_factory.getbasetemp() / "names.yaml"
    save_names(file, table.items())
    assert read_names(file) == table


def test_the_turn_of_a_visual_counts(tmp_path):
    body = visual(more=f"<pose>1 0 0 0 0 {math.pi / 2}</pose>")
    ((found,), _) = read(write_world(tmp_path / "a.world", model("m", body, "0 0 1 0 0 0")))
    assert found.T_world_visual[:3, 3] == pytest.approx((1, 0, 1))
    assert found.T_world_visual[:3, 0] == pytest.approx((0, 1, 0))
