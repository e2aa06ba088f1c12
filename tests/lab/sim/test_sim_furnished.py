"""Furnished houses: a small catalogue made here, and Debian's where it is installed."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from simulated import simulated

from edge.lab.eval.world_list import world_sections
from edge.lab.sim.base import WorldError
from edge.lab.sim.catalogue import object_label, read_catalogue
from edge.lab.sim.worlds import load_world

DEBIAN = Path("/usr/share/sweethome3d/furniture")

# Name, section, width, depth, height, height of the top [cm], colour.
MODELS = [
    ("Sofa 2 seats", "Living room", 190, 90, 80, 40, (200, 40, 40)),
    ("Bench 1", "Living room", 180, 85, 75, 45, (40, 200, 40)),
    ("Winchester armchair", "Living room", 80, 80, 90, 45, (40, 40, 200)),
    ("Wooden table", "Living room", 140, 85, 74, 74, (150, 100, 60)),
    ("Oak bed", "Bedroom", 145, 200, 95, 60, (90, 90, 160)),
    ("Coffee mug", "Kitchen", 9, 9, 10, -1, (250, 250, 0)),
    ("Lamp post", "Exterior", 30, 30, 60, -1, (0, 0, 0)),
]
# A box of 1 m in the axes of OBJ: x right, y up, z to the viewer.
_OBJ = """mtllib m.mtl
usemtl m
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
vt 0 0
f 1/1 4/1 3/1 2/1
f 5/1 6/1 7/1 8/1
f 1/1 2/1 6/1 5/1
f 2/1 3/1 7/1 6/1
f 3/1 4/1 8/1 7/1
f 4/1 1/1 5/1 8/1
"""


def write_catalogue(folder: Path, models=MODELS) -> Path:
    folder.mkdir(exist_ok=True)
    lines = ["id=test"]
    with zipfile.ZipFile(folder / "test.sh3f", "w") as archive:
        for k, (name, section, width, depth, height, top, color) in enumerate(models, start=1):
            row = {
                "name": name, "category": section, "model": f"/m{k}/m.obj", "width": width,
                "depth": depth, "height": height, "dropOnTopElevation": top,
            }  # fmt: skip
            lines += [f"{key}#{k}={value}" for key, value in row.items()]
            shade = " ".join(str(c / 255) for c in color)
            archive.writestr(f"m{k}/m.obj", _OBJ)
            archive.writestr(f"m{k}/m.mtl", f"newmtl m\nKd {shade}\n")
        archive.writestr("PluginFurnitureCatalog.properties", "\n".join(lines))
    return folder


def furnished(catalogue: Path, seed: int = 7, **house):
    house = house or {"kind": "generated", "seed": seed}
    section = {"kind": "furnished", "seed": seed, "house": house, "catalogue": str(catalogue)}
    return simulated({"sim": {"world": section}})


def test_a_folder_without_catalogues_is_refused(tmp_path):
    with pytest.raises(WorldError, match=r"no \.sh3f file; install Debian's package"):
        read_catalogue(tmp_path)


@pytest.mark.parametrize(
    "content", [b"", b"not a zip", None], ids=["empty", "no archive", "no list of models"]
)
def test_a_damaged_catalogue_is_an_error_of_one_line(tmp_path, content):
    if content is None:
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w") as empty:
            empty.writestr("other.txt", "")
        content = archive.getvalue()
    (tmp_path / "bad.sh3f").write_bytes(content)
    with pytest.raises(WorldError, match=r"bad\.sh3f: not a furniture catalogue") as error:
        read_catalogue(tmp_path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("Winchester sofa", "sofa"),
        ("Sofa 3 seats", "sofa"),
        ("Chair with cushion 2", "chair"),
        ("Apple iMac", "computer monitor"),
        ("Toilets unit", "toilet"),
        ("Plate, glass and cutlery", "plate"),
        ("Wooden", "wooden"),
    ],
)
def test_names_of_models_become_names_of_objects(name, label):
    assert object_label(name) == label


def test_models_have_the_sizes_of_the_catalogue_in_metres(tmp_path):
    models = read_catalogue(write_catalogue(tmp_path / "sizes"))
    assert len(models) == len(MODELS)
    bed = next(model for model in models if model.label == "bed")
    assert bed.size_m == pytest.approx((2.0, 1.45, 0.95))
    assert (bed.top_m, bed.bottom_m) == (0.6, 0.0)
    assert next(model for model in models if model.label == "mug").top_m is None


@pytest.mark.weights
class TestLoading:
    @pytest.fixture(autouse=True)
    def _extra(self):
        pytest.importorskip("trimesh", reason="needs the extra `worlds`")
        pytest.importorskip("embreex", reason="needs the extra `worlds`")

    def test_models_replace_the_objects_of_the_house(self, tmp_path):
        config = furnished(write_catalogue(tmp_path / "catalogue"))
        world = load_world(config)
        boxes = load_world(simulated({"sim": {"world": {"kind": "generated", "seed": 7}}}))
        assert world.rooms == boxes.rooms
        labels = {item.label for item in world.objects}
        assert {"bed", "armchair"} <= labels
        assert "street light" not in labels  # it stands outside
        for item in world.objects:
            assert item.label in {object_label(row[0]) for row in MODELS}
        # An object on the floor takes the place of another one.
        for item in world.objects:
            if item.center_m[2] - 0.5 * item.size_m[2] < 0.02:
                x_m, y_m = item.center_m[:2]
                assert min(box.distance_m(x_m, y_m) for box in boxes.objects) < 0.02

    def test_a_seed_means_one_house(self, tmp_path):
        catalogue = write_catalogue(tmp_path / "same")
        first, again, other = (load_world(furnished(catalogue, seed)) for seed in (3, 3, 4))
        places = [[(o.name, o.center_m) for o in world.objects] for world in (first, again, other)]
        assert places[0] == places[1] != places[2]

    def test_small_objects_stand_on_furniture(self, tmp_path):
        world = load_world(furnished(write_catalogue(tmp_path / "small"), seed=5))
        mugs = [item for item in world.objects if item.label == "mug"]
        tables = [item for item in world.objects if item.label == "table"]
        assert mugs
        for mug in mugs:
            bottom_m = mug.center_m[2] - 0.5 * mug.size_m[2]
            under = [t for t in tables if t.distance_m(*mug.center_m[:2]) < 0.05]
            assert any(abs(t.center_m[2] + 0.5 * t.size_m[2] - bottom_m) < 0.02 for t in under)

    @pytest.mark.skipif(not DEBIAN.is_dir(), reason="needs Debian's sweethome3d-furniture")
    def test_debians_catalogue_names_more_than_two_hundred_objects(self):
        models = read_catalogue(DEBIAN)
        assert len(models) > 700
        assert len({model.label for model in models}) > 200
        world = load_world(furnished(DEBIAN, seed=3))
        assert len({item.label for item in world.objects}) > 20
        assert np.isfinite(world.plan.clearance_m).all()


def test_lists_of_worlds_have_furnished_houses(tmp_path):
    houses = tmp_path / "houses.jsonl"
    houses.write_text('{"name": "a"}\n{"name": "b"}\n')
    assert world_sections(["furnished[3:5]", f"furnished:{houses}[1]"]) == [
        {"kind": "furnished", "house": {"kind": "generated", "seed": 3}, "seed": 3},
        {"kind": "furnished", "house": {"kind": "generated", "seed": 4}, "seed": 4},
        {"kind": "furnished", "house": {"kind": "procthor", "file": str(houses), "name": "b"},
         "seed": 0},
    ]  # fmt: skip
