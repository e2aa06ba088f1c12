"""The page of a scene: whole without a network, drawn by a browser, safe from any name."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import Tab, open_chromium

from edge.geometry import SE2, Grid
from edge.lab.report.view3d import VOXEL_M, coarse_and_refined, scene_page
from edge.tasks.refine import RefinedTrajectory, refine
from edge.tasks.scene.scene import Region, Scene, SceneObject
from edge.tasks.scene.value_map import PathMargins
from edge.trajectory.pursuit import MotionLimits

COARSE_M = np.array([[0.0, 0.0], [6.0, 3.0], [12.0, 0.0]])
HOSTILE = '</script><img src=x onerror="alert(1)">'


def empty() -> Scene:
    grid = Grid(np.zeros((0, 0), np.int8), (0.0, 0.0), 0.2)
    regions = replace(grid, cells=np.zeros((0, 0), np.uint8))
    return Scene(0, SE2(0.0, 0.0, 0.0), {}, {}, grid, regions, None, None, None, {})


def with_a_car(label: str = "car") -> Scene:
    cells, regions = np.zeros((60, 100), np.int8), np.zeros((60, 100), np.uint8)
    cells[28:33, 35:45], cells[:, :5] = 100, -1
    regions[20:50] = 7
    place = ((-2.0, -6.0), 0.2)
    u = np.linspace(-0.5, 0.5, 40, dtype=np.float32)
    wall = np.stack(np.meshgrid(4 * u + 6, [-0.9], 1.4 * u + 0.7), axis=-1).reshape(-1, 3)
    car = SceneObject(
        1, label, f"red {label}", np.array([6.0, 0.0, 0.7]), np.array([4.0, 1.8, 1.4]), 0.0, wall,
        {7: (6.0, 1.5)},
    )  # fmt: skip
    named = {7: Region(7, "road", 100.0)}
    return Scene(
        0, SE2(0.0, 0.0, 0.0), {1: car}, named, Grid(cells, *place), Grid(regions, *place),
        None, None, None, {},
    )  # fmt: skip


def trajectory(scene: Scene) -> RefinedTrajectory:
    return refine(scene, [COARSE_M[1:]], {7}, PathMargins(0.4), MotionLimits(1.0, 1.0, 0.8, 3.0))


def page(scene: Scene, cloud_m: np.ndarray | None = None) -> str:
    refined = trajectory(scene)
    lines = coarse_and_refined(COARSE_M, refined)
    facts = [("length", "13 m")]
    return scene_page(
        "past the car", scene, lines, "a machine", refined=refined, cloud_m=cloud_m, facts=facts
    )


def data_of(html: str) -> dict[str, Any]:
    (text,) = re.findall(r"<script>const DATA = (.*);\n", html)
    return json.loads(text)


def unpacked(text: str, dtype: str) -> np.ndarray:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype)


def test_an_empty_scene_is_a_page():
    html = scene_page("nothing", empty(), [], "a machine")
    assert "No objects were found." in html
    data = data_of(html)
    assert (data["boxes"], data["lines"], data["poses"]) == ([], [], [])
    assert unpacked(data["cloud"]["xyz_cm"], "<i2").size == 0


def test_the_page_holds_the_given_scene():
    scene = with_a_car()
    cloud_m = np.array([[9.0, 2.0, 0.0], [np.nan, 0.0, 0.0], [1e9, 0.0, 0.0]], np.float32)
    data = data_of(page(scene, cloud_m))
    xyz = unpacked(data["cloud"]["xyz_cm"], "<i2").reshape(-1, 3)
    kind = unpacked(data["cloud"]["kind"], "u1")
    assert (xyz[kind == 0] == [[900, 200, 0]]).all()
    # One point a voxel, of the car 4 m long and 1.4 m high.
    assert 0.5 < (kind == 1).sum() / (4.0 * 1.4 / VOXEL_M**2) < 1.2
    cells = unpacked(data["ground"]["cells"], "u1").reshape(60, 100)
    assert (cells[0, 0], cells[30, 40], cells[30, 60], cells[5, 60]) == (254, 255, 7, 0)
    assert data["lines"][0]["points"][1] == [6.0, 3.0, 0.05]
    assert len(data["poses"]) == len(data["when"]) == len(trajectory(scene).poses)
    assert data["boxes"][0]["at"] == [6.0, 0.0, 0.7]


def test_the_page_is_small_and_loads_nothing():
    html = page(with_a_car())
    assert not re.search(r"https?://|//[a-z]+\.|@import|url\(", html)
    assert len(html) < 40_000


def test_a_name_is_escaped():
    html = page(with_a_car(HOSTILE))
    assert "<img" not in html
    assert html.count("</script>") == 1
    assert data_of(html)["boxes"][0]["label"] == HOSTILE


@pytest.fixture(scope="module")
def tab():
    with open_chromium() as tab:
        tab.size(1000, 800)
        yield tab


def opened(tab: Tab, path: Path, html: str) -> None:
    path.write_text(html, encoding="utf-8")
    tab.open(path.as_uri())
    tab.until("document.querySelector('#view').dataset.drawn > 0")


def pixels(tab: Tab, colour: tuple[int, int, int]) -> int:
    return tab.run(
        f"""(() => {{
          draw();
          const {{ data }} = context.getImageData(0, 0, width, height);
          let count = 0;
          for (let k = 0; k < data.length; k += 4)
            count += data[k] === {colour[0]} && data[k + 1] === {colour[1]}
              && data[k + 2] === {colour[2]};
          return count;
        }})()"""
    )


CAR, ROAD, REFINED = (201, 42, 42), (98, 102, 110), (214, 34, 91)


@pytest.mark.parametrize("label", ["car", HOSTILE])
def test_a_browser_draws_the_scene(tab, tmp_path, label):
    before = len(tab.asked)
    opened(tab, tmp_path / "scene.html", page(with_a_car(label)))
    assert tab.asked[before:] == [(tmp_path / "scene.html").as_uri()]
    assert pixels(tab, CAR) > 200
    assert pixels(tab, ROAD) > 20_000
    assert pixels(tab, REFINED) > 200
    assert tab.complaints == []


def test_an_empty_scene_is_drawn_too(tab, tmp_path):
    opened(tab, tmp_path / "empty.html", scene_page("nothing", empty(), [], "a machine"))
    assert pixels(tab, ROAD) == 0
    assert tab.complaints == []


ROBOT = (20, 24, 31)


def test_without_a_trajectory_robot_and_objects_are_in_view(tab, tmp_path):
    """A refused instruction still shows robot and objects."""
    scene = with_a_car()
    far = replace(scene.objects[1], id=2, position_m=np.array([45.0, 12.0, 0.7]))
    scene.objects[2] = far
    opened(tab, tmp_path / "scene.html", scene_page("refused", scene, [], "a machine"))
    tab.run("draw()")
    for box in tab.run("DATA.boxes.map((box) => onScreen(seen(...box.at)))"):
        assert 0 < box[0] < tab.run("width")
        assert 0 < box[1] < tab.run("height")
    assert pixels(tab, ROBOT) > 10
    assert tab.complaints == []


def test_the_controls_change_the_view(tab, tmp_path):
    opened(tab, tmp_path / "scene.html", page(with_a_car()))
    assert pixels(tab, REFINED) > 200
    tab.click("[data-line='1']")
    assert pixels(tab, REFINED) == 0
    tab.run(
        "(() => { const s = document.querySelector('#along'); s.value = s.max;"
        " s.dispatchEvent(new Event('input')); })()"
    )
    tab.says("#when", "0.00 m/s")
    behind = tab.run("[eye.pitch, eye.far]")
    tab.click("[data-view='above']")
    assert tab.run("eye.pitch") > behind[0]
    tab.click("[data-view='robot']")
    assert tab.run("[eye.x, eye.y]") == pytest.approx([12 + 4 * 0.92, -4 * 0.39], abs=0.8)
    tab.run("document.querySelector('#view').dispatchEvent(new WheelEvent('wheel', {deltaY: 99}))")
    assert tab.run("eye.far") > 6.0
    assert tab.complaints == []


def test_dragging_pans_and_turns_the_view(tab, tmp_path):
    opened(tab, tmp_path / "scene.html", page(with_a_car()))
    tab.click("[data-view='above']")
    # The ground under the hand goes with it: where (6, 0) is on the screen, before and after.
    tab.run("aim(); window.was = onScreen(seen(6, 0, 0)); pan(40, -25); aim();")
    moved = tab.run("onScreen(seen(6, 0, 0)).map((value, k) => value - was[k])")
    assert moved == pytest.approx([40.0, -25.0], abs=3.0)
    yaw = tab.run("eye.yaw")
    tab.run("turn(0.5, 9)")
    assert tab.run("[eye.yaw, eye.pitch]") == pytest.approx([yaw - 0.5, 1.5])
