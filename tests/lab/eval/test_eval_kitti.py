from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from made_sequence import IDENTITY, P2, TR, write

from edge.geometry import invert
from edge.lab.eval import kitti
from edge.lab.eval.kitti import (
    GROUND_LABELS,
    KittiError,
    frames_in,
    objects_in,
    objects_shown,
    read_frame,
    scene_of,
    solid_m,
    true_boxes,
)
from edge.tasks.scene import terrain
from edge.tasks.scene.projection import in_picture, points_of_masks
from edge.tasks.scene.scene_builder import OFF_GROUND_M


def test_an_empty_folder_has_no_frames(tmp_path):
    with pytest.raises(KittiError, match="no frame with image_2/"):
        frames_in(tmp_path)


def test_without_labels_there_are_the_camera_and_the_scan(tmp_path):
    folder = write(tmp_path)
    (folder / "labels/000000.label").unlink()
    with pytest.raises(KittiError, match="no frame with image_2/, velodyne/ and labels/"):
        frames_in(folder)
    assert frames_in(folder, labelled=False) == [0]
    frame = read_frame(folder, 0, labelled=False)
    assert len(frame.observation.cloud_m) == 230
    assert not frame.semantic.any()
    assert objects_in(frame) == []


def test_a_frame_has_the_poses_of_its_sensors(tmp_path):
    frame = read_frame(write(tmp_path), 0)
    seen = frame.observation
    np.testing.assert_allclose(seen.T_map_base, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(seen.T_base_lidar[:3, 3], [0, 0, kitti.LIDAR_HEIGHT_M])
    # Camera 2 is 0.2 m to the left of camera 0 and 0.1 m over it: P2's last column, in metres.
    np.testing.assert_allclose(seen.T_base_camera[:3, 3], [0.3, 0.2, 1.63 + 0.1], atol=1e-9)
    np.testing.assert_allclose(seen.T_base_camera[:3, 2], [1, 0, 0], atol=1e-12)
    assert seen.rgb[0, 0].tolist() == [200, 20, 10]
    assert frame.ground_kind.tolist() == [GROUND_LABELS.index("road") + 1] * 200 + [0] * 30


@pytest.mark.parametrize("rubbish", [np.nan, np.inf, -np.inf, 3e38, 1e8])
def test_rubbish_in_a_scan_is_left_out(tmp_path, rubbish):
    """Every fifth return of the road and of the car is noise."""
    folder = write(tmp_path, points=20_000)
    path = folder / "velodyne/000000.bin"
    scan = np.fromfile(path, np.float32).reshape(-1, 4)
    scan[::5, :3] = rubbish
    scan.tofile(path)
    frame = read_frame(folder, 0)
    assert len(frame.observation.cloud_m) == len(frame.semantic) == 0.8 * len(scan)
    (car,) = scene_of([frame]).objects.values()
    np.testing.assert_allclose(car.position_m, [10.1, 0.0, 0.83], atol=0.25)


def cut(path, n):
    path.write_bytes(path.read_bytes()[:n])


BROKEN = {
    "no calibration": (lambda f: (f / "calib.txt").unlink(), r"calib\.txt: cannot be read"),
    "no P2": (lambda f: (f / "calib.txt").write_text(f"Tr: {TR}\n"), "a line `P2:`"),
    "no Tr": (lambda f: (f / "calib.txt").write_text(f"P2: {IDENTITY}\n"), "a line `Tr:`"),
    "words for numbers": (lambda f: (f / "calib.txt").write_text("P2: a b\n"), "P2: expected 12"),
    "short poses": (lambda f: (f / "poses.txt").write_text("1 0 0\n"), r"poses\.txt: expected 12 "
    r"(finite )?numbers"),
    "no poses": (lambda f: (f / "poses.txt").write_text(""), r"poses\.txt: expected 12 (finite "
    r")?numbers"),
    "NaN poses": (lambda f: (f / "poses.txt").write_text("nan " * 12), r"poses\.txt: expected 12 "
    r"(finite )?numbers"),
    "an image that is none": (
        lambda f: (f / "image_2/000000.png").write_bytes(b"no"), r"000000\.png: not a readable "
        r"image",
    ),
    "an empty image": (
        lambda f: (f / "image_2/000000.png").write_bytes(b""), r"000000\.png: not a readable image",
    ),
    "a scan cut off": (
        lambda f: cut(f / "velodyne/000000.bin", 30), r"\.bin: 30 bytes are not a multiple of",
    ),
    "labels of another": (
        lambda f: cut(f / "labels/000000.label", 40), "230 points but 10 labels",
    ),
    "a picture of one pixel": (
        lambda f: cv2.imwrite(str(f / "image_2/000000.png"), np.zeros((1, 1, 3), np.uint8)),
        r"calib\.txt: P2 does not fit 000000\.png \(1x1 px\): not a camera: principal point",
    ),
    "a camera without depth": (
        lambda f: (f / "calib.txt").write_text(f"P2: {P2.replace('1 0', '0 0')}\nTr: {TR}\n"),
        r"P2 does not fit .*: Singular matrix",
    ),
    "a scale for a rotation": (
        lambda f: (f / "calib.txt").write_text(f"P2: {P2}\nTr: {TR.replace('1', '2')}\n"),
        r"calib\.txt: Tr: expected a rotation",
    ),
    "a pose out of this world": (
        lambda f: (f / "poses.txt").write_text(f"{IDENTITY}\n".replace("0 0 1 0", "0 0 1 1e30")),
        r"poses\.txt: line 1: expected a rotation matrix, and a translation of at most 1000 km",
    ),
    "binary calibration": (lambda f: (f / "calib.txt").write_bytes(b"\xff"), "not an ASCII text "
    "file"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_an_unusable_frame_is_reported_in_one_line(tmp_path, case):
    damage, words = BROKEN[case]
    folder = write(tmp_path)
    damage(folder)
    with pytest.raises(KittiError, match=words) as error:
        read_frame(folder, 0)
    assert "\n" not in str(error.value)


def test_a_frame_beyond_the_poses(tmp_path):
    with pytest.raises(KittiError, match=r"frame 7: poses\.txt and times\.txt end at frame 1"):
        read_frame(write(tmp_path), 7)


# -- the real sequence ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sequence(shared_dir):
    return shared_dir / "logs" / "semantic_kitti_05"


def test_masks_have_the_points_that_the_labels_give_them(sequence):
    """Compare eq. 2 on real scans with the labels.

    The medians are 0.99 and 0.96 with boxes and masks, 0.99 and 1.0 with boxes alone.
    """
    frame = read_frame(sequence, 0)
    seen = frame.observation
    T_map_lidar = seen.T_map_base @ seen.T_base_lidar
    points = (seen.cloud_m @ T_map_lidar[:3, :3].T + T_map_lidar[:3, 3]).astype(np.float32)
    ground = terrain.estimate_ground(points, 0.0, 0.0, 0.0, 50.0)
    above = terrain.height_above(ground, points) > OFF_GROUND_M
    is_road = np.isin(frame.semantic, [40, 60]) & (np.abs(points[:, :2]).max(axis=1) < 25.0)
    assert above[is_road].mean() < 0.01
    found = true_boxes(frame)
    T_camera_lidar = invert(seen.T_base_camera) @ seen.T_base_lidar
    _, in_view = in_picture(seen.cloud_m, T_camera_lidar, seen.camera)
    objects = objects_shown(frame)
    assert len(objects) == len(found)
    assert all(in_view[points].all() for _, points in objects)
    for mask in (found.mask, None):
        shown = points_of_masks(
            seen.cloud_m, T_camera_lidar, seen.camera, found.xyxy_px, mask, above
        )
        pure = []
        for i, mine in enumerate(shown):
            codes = [
                c
                for c, name in kitti.OBJECT_NAMES.items()
                if name == found.prompts[found.class_id[i]]
            ]
            if len(mine) and codes:
                pure.append(np.isin(frame.semantic[mine], codes).mean())
        assert len(pure) >= 10
        assert np.median(pure) > 0.95


def test_a_real_street_becomes_a_scene(sequence):
    """The advertising pillar, the van behind it and the hedge, after five frames."""
    scene = scene_of([read_frame(sequence, number) for number in frames_in(sequence)])
    assert scene.pose.x_m == pytest.approx(4.53, abs=0.05)
    labels = [obj.label for obj in scene.objects.values()]
    for label in ("car", "truck", "building", "bush", "pole", "sign"):
        assert label in labels
    regions = {region.label for region in scene.regions.values()}
    assert {"road", "sidewalk", "terrain"} <= regions
    road = scene.regions[1]
    assert (road.label, road.area_m2 > 700.0) == ("road", True)
    assert scene.regions_grid.cells[scene.regions_grid.cell_of(4.5, 0.0)] == 1
    pillar = next(o for o in scene.objects.values() if o.caption.startswith("white object"))
    np.testing.assert_allclose(pillar.position_m[:2], [31.3, 7.0], atol=1.0)
    assert all(obj.nearest_m for obj in scene.objects.values())


def test_obstacles_are_found_by_points(tmp_path):
    """Compare standing objects up to the robot's height with their points."""
    frame = read_frame(write(tmp_path), 0)
    solid = solid_m([frame])
    assert 20 < len(solid) <= 30
    assert ((solid[:, 0] > 9.9) & (solid[:, 0] < 10.3)).all()
    high = frame.observation.cloud_m + np.where(frame.semantic == 10, 3.0, 0.0)[:, None] * (0, 0, 1)
    tall = replace(frame.observation, cloud_m=high.astype(np.float32))
    moved = np.where(frame.semantic == 10, 252, frame.semantic).astype(np.uint16)
    for other in (replace(frame, observation=tall), replace(frame, semantic=moved)):
        assert len(solid_m([other])) == 0
