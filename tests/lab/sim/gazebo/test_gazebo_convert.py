"""`edge worlds import`, from a world file to pictures of the simulator."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from gazebo_files import model, visual, write_model, write_world

from edge.cli.main import main
from edge.config import load
from edge.geometry import SE2, CameraModel, se3, to_optical

pytest.importorskip("trimesh", reason="needs the extra `worlds`")
pytest.importorskip("collada", reason="needs the extra `worlds`")
import trimesh
from PIL import Image

pytestmark = pytest.mark.weights

RED = (230, 20, 20)
# A panel of 1 m by 1 m in the plane x = 0, with a texture, as .obj and .dae.
CORNERS = ((0, -0.5, 0), (0, 0.5, 0), (0, 0.5, 1), (0, -0.5, 1))
OBJ = "mtllib a.mtl\n{}usemtl m\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n".format(
    "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
    + "".join(f"vt {u} {v}\n" for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)))
)
FLOOR = model(
    "floor_1", visual("<geometry><plane><size>100 100</size></plane></geometry>")
)  # fmt: skip


def picture(path: Path, color) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (16, 16), color).save(path)


def mesh(uri: str, more: str = "") -> str:
    return f"<geometry><mesh><uri>{uri}</uri>{more}</mesh></geometry>"


def imported(world: Path, models: Path, out: Path) -> int:
    return main(["worlds", "import", str(world), "--models", str(models), "--out", str(out)])


def box_of(out: Path, name: str):
    items = json.loads((out / "w.objects.json").read_text())
    (item,) = (each for each in items if each["category"] == name)
    return item["aabb_min"], item["aabb_max"]


@pytest.fixture
def house(tmp_path):
    """Return a world: a textured panel, a bed of Ogre's blue, a green chair; and its models."""
    models = tmp_path / "models"
    sofa = write_model(models, "acme_SofaA_01", visual(mesh("model://acme_SofaA_01/meshes/a.obj")))
    (sofa / "meshes").mkdir()
    (sofa / "meshes" / "a.obj").write_text(OBJ)
    # The texture has a path of another computer, and lies where Gazebo's models have it.
    (sofa / "meshes" / "a.mtl").write_text("newmtl m\nmap_Kd C:\\work\\red.tga\n")
    picture(sofa / "materials" / "textures" / "red.png", RED)
    script = (
        "<material><script><uri>model://bed/materials/scripts</uri><name>Acme/Blue</name>"
        "</script></material>"
    )
    bed = write_model(models, "bed", visual(mesh("meshes/b.stl"), script))
    (bed / "materials" / "scripts").mkdir(parents=True)
    (bed / "materials" / "scripts" / "any.material").write_text(
        "material Acme/Base\n{\n technique { pass {\n diffuse 0.1 0.1 0.9 1 // blue\n} } }\n"
        "material Acme/Blue : Acme/Base\n{\n}\n"
    )
    (bed / "meshes").mkdir()
    trimesh.creation.box((1, 1, 1)).export(bed / "meshes" / "b.stl")
    green = "<material><diffuse>0.1 0.8 0.1 1</diffuse></material>"
    body = FLOOR + "".join(
        f"<include><uri>model://{name}</uri><pose>{pose}</pose></include>"
        for name, pose in (("acme_SofaA_01", "3 0 0 0 0 0"), ("bed", "0 3 0.5 0 0 0"))
    )
    body += model("chair 2", visual(more=green), "0 -3 1.5 0 0 0")
    return write_world(tmp_path / "worlds" / "w.world", body), models


def test_a_world_is_simulated_with_its_textures_and_names(house, tmp_path, capsys):
    pytest.importorskip("embreex", reason="needs the extra `worlds`")
    from edge.lab.sim.worlds import load_world

    out = tmp_path / "out"
    assert imported(*house, out) == 0
    printed = capsys.readouterr().out
    assert "4 of 4 visuals, 3 objects of 3 names" in printed
    assert "left out" not in printed
    config = load(str(out / "w.yaml"))
    world = load_world(config)
    assert sorted(each.label for each in world.objects) == ["bed", "chair", "sofa"]
    camera = CameraModel.from_hfov(64, 48, 1.2)
    rgb, depth = np.empty((48, 64, 3), np.uint8), np.empty((48, 64), np.float32)
    ids = np.empty((48, 64), np.uint16)
    seen = {}
    for yaw, name in ((0.0, "sofa"), (0.5 * np.pi, "bed"), (-0.5 * np.pi, "chair")):
        T_map_camera = SE2(0.0, 0.0, yaw).matrix() @ to_optical(se3(z_m=0.4))
        world.render(camera, T_map_camera, rgb, depth, ids)
        assert world.objects[ids[24, 32] - 1].label == name
        red, green, blue = rgb[24, 32] / rgb[24, 32].max()
        seen[name] = (round(red, 1), round(green, 1), round(blue, 1))
    assert seen == {"sofa": (1.0, 0.1, 0.1), "bed": (0.1, 0.1, 1.0), "chair": (0.1, 1.0, 0.1)}
    assert np.isfinite(depth[-1, 32]), "the floor is there"


def test_a_plane_is_cut_to_the_building(house, tmp_path):
    imported(*house, tmp_path / "out")
    bounds = trimesh.load_scene(tmp_path / "out" / "w.glb").bounds
    assert bounds[:, :2].tolist() == [[-0.5, -4.0], [3.0, 3.5]]


def test_edited_names_are_used_again(house, tmp_path):
    out = tmp_path / "out"
    imported(*house, out)
    table = out / "w.names.yaml"
    assert '"acme_SofaA_01": "sofa"' in table.read_text()
    table.write_text("acme_SofaA_01: cinema screen\nbed: structure\n")
    imported(*house, out)
    items = json.loads((out / "w.objects.json").read_text())
    assert sorted(each["category"] for each in items) == ["chair", "cinema screen"]
    assert '"chair 2": "chair"' in table.read_text()


def test_the_unit_of_collada_counts_and_its_axis_does_not(tmp_path):
    models = tmp_path / "models"
    folder = write_model(models, "sofa", visual(mesh("a.dae", "<scale>1 1 2</scale>")))
    cube = trimesh.creation.box((100, 200, 50))
    content = trimesh.exchange.dae.export_collada(cube).decode()
    asset = '<unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis></asset>'
    start, end = content.index("<unit") if "<unit" in content else None, content.index("</asset>")
    start = end if start is None else start
    (folder / "a.dae").write_text(content[:start] + asset + content[end + len("</asset>") :])
    world = write_world(tmp_path / "w.world", "<include><uri>model://sofa</uri></include>")
    assert imported(world, models, tmp_path) == 0
    low, high = box_of(tmp_path, "sofa")
    assert np.subtract(high, low) == pytest.approx((1.0, 2.0, 1.0))


SHAPES = {
    "box": ("<size>1 2 3</size>", (1, 2, 3)),
    "cylinder": ("<radius>1</radius><length>3</length>", (2, 2, 3)),
    "sphere": ("<radius>1</radius>", (2, 2, 2)),
    "capsule": ("<radius>1</radius><length>3</length>", (2, 2, 5)),
    "ellipsoid": ("<radii>1 2 3</radii>", (2, 4, 6)),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_shapes_have_their_size(tmp_path, kind):
    body, size = SHAPES[kind]
    shape = f"<geometry><{kind}>{body}</{kind}></geometry>"
    world = write_world(tmp_path / "w.world", model("sofa", visual(shape)))
    assert imported(world, tmp_path, tmp_path) == 0
    low, high = box_of(tmp_path, "sofa")
    assert np.subtract(high, low) == pytest.approx(size, abs=0.02)
    assert np.add(high, low) == pytest.approx((0, 0, 0), abs=0.02)


def write_mesh(folder: Path, name: str, content: str) -> None:
    (folder / name).write_text(content)


LEFT_OUT = {
    "no mesh": (mesh("a.obj"), {}, "<mesh>: a.obj is in no model folder"),
    "a broken mesh": (mesh("a.glb"), {"a.glb": "glTF"}, "a.glb: not a readable mesh"),
    "no triangles": (mesh("a.obj"), {"a.obj": "v 1 2 3"}, "a.obj: "),
    "a format": (mesh("a.blend"), {"a.blend": ""}, "blend cannot be read"),
    "entities": (mesh("a.dae"), {"a.dae": "<!DOCTYPE a><COLLADA/>"}, "has a document type"),
    "a part": (
        mesh("a.obj", "<submesh><name>leg</name></submesh>"), {"a.obj": OBJ, "a.mtl": ""},
        "has no part 'leg'",
    ),
    "a size of words": ("<geometry><box><size>big</size></box></geometry>", {}, "<size> is 'big'"),
    "a heightmap": ("<geometry><heightmap><a/></heightmap></geometry>", {}, "<heightmap> cannot"),
    "a texture": (
        mesh("a.obj"), {"a.obj": OBJ, "a.mtl": "newmtl m\nmap_Kd ../../../../etc/a.png\n"},
        "'../../../../etc/a.png' is in no model folder",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", LEFT_OUT)
def test_a_missing_shape_is_counted_in_one_line(tmp_path, capsys, case):
    shape, files, reason = LEFT_OUT[case]
    for name, content in files.items():
        write_mesh(tmp_path, name, content)
    body = model("sofa", visual(shape)) + model("bed")
    assert imported(write_world(tmp_path / "w.world", body), tmp_path, tmp_path) == 0
    lines = capsys.readouterr().out.splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("left out or changed: 1"))
    assert lines[at + 1].startswith("  1 x ")
    assert reason in lines[at + 1]


def test_an_empty_world_is_refused(tmp_path, capsys):
    assert imported(write_world(tmp_path / "w.world", ""), tmp_path, tmp_path) == 65
    assert "nothing to import" in capsys.readouterr().err
