"""Episodes of each source: named objects are in the scene, and references can be driven."""

from __future__ import annotations

from itertools import islice
from shutil import copyfile

import made_sequence
import numpy as np
import pytest

from edge.lab.eval import kitti
from edge.lab.eval.trajectories.episodes import episodes
from edge.lab.eval.trajectory_metrics import contacts
from edge.perception.embedding.text import PromptError
from edge.tasks.scene.pipeline import PerceptionPipeline, boxes_as_masks
from edge.tasks.sentences.reading import named_objects
from edge.types import Detections

SOURCES = {
    "streets": "streets[0:4]",
    "house": "house:demo",
    "kitti": "kitti:{}/logs/semantic_kitti_05",
}


@pytest.fixture(scope="module")
def recorded(shared_dir):
    """Return the first episode of a recorded street."""
    (one,) = episodes([SOURCES["kitti"].format(shared_dir)], 1)
    return one


@pytest.mark.parametrize("source", SOURCES)
def test_an_episode_is_whole(source, request):
    shared = request.getfixturevalue("shared_dir") if source == "kitti" else ""
    found = list(islice(episodes([SOURCES[source].format(shared)]), 4))
    assert len({one.id for one in found}) == 4
    for one in found:
        scene, task = one.scene, one.task
        assert one.source == source
        assert contacts(task.reference_m, one.truth, one.robot_m) == 0
        np.testing.assert_allclose(task.reference_m[0], (scene.pose.x_m, scene.pose.y_m))
        labels = [obj.label for obj in scene.objects.values()]
        landmarks = {obj.id: obj for obj in one.landmarks}
        for number in task.landmarks:
            assert landmarks[number].label in labels
            assert landmarks[number].label in task.instruction


def test_occupied_cells_hold_points_of_labelled_objects(recorded):
    """Grass on a slope is no obstacle: each occupied cell holds a point of a labelled object."""
    one = recorded
    solid = np.unique(np.floor(one.truth.to_cells(one.solid_m)), axis=0)
    h, w = one.truth.cells.shape
    inside = ((solid >= 0) & (solid < (w, h))).all(axis=1)
    occupied = np.argwhere(one.truth.cells > 0)[:, ::-1]
    assert {*map(tuple, occupied.tolist())} == {*map(tuple, solid[inside].astype(int).tolist())}


def test_frames_of_different_sequences_are_different_places(recorded, shared_dir):
    (other,) = episodes([f"kitti:{shared_dir}/logs/semantic_kitti_06"], limit=1)
    assert recorded.world != other.world
    assert all(one.world.startswith("kitti-semantic_kitti_0") for one in (recorded, other))


def test_frames_far_from_the_first_are_not_read_yet(tmp_path, monkeypatch):
    read, far = [], 1000
    folder = made_sequence.write(tmp_path / "sequence", poses=far + 1)
    (folder / "times.txt").write_text("".join(f"{0.1 * k}\n" for k in range(far + 1)))
    for kind in ("image_2/000000.png", "velodyne/000000.bin", "labels/000000.label"):
        for number in (2, far):
            copyfile(folder / kind, folder / kind.replace("000000", f"{number:06d}"))
    read_frame = kitti.read_frame
    monkeypatch.setattr(
        kitti, "read_frame", lambda *args: read.append(args[1]) or read_frame(*args)
    )
    found = episodes([f"kitti:{folder}"])
    next(found)
    assert read == [0, 2]
    assert any(one.world.endswith(f"{far:06d}") for one in found)


def test_a_blind_detector_changes_the_scene_but_not_the_task(recorded, shared_dir):
    """A chain that sees nothing: the same tasks and references, no objects, ground without kinds.

    It is asked for what the instruction names, and if it lacks a word, for its own.
    """
    asked = []

    def boxes(observation, tags):
        asked.append(tuple(tags))
        if len(asked) == 1:
            raise PromptError("not in the vocabulary")
        none = np.zeros(0, np.float32)
        return Detections(observation, none.reshape(0, 4), none, none.astype(np.int32), tuple(tags))

    by_labels = recorded
    blind = PerceptionPipeline(lambda observation: ("car",), boxes, boxes_as_masks)
    (seen,) = episodes([SOURCES["kitti"].format(shared_dir)], 1, blind)
    assert asked == [named_objects(seen.task.instruction), ("car",)]
    assert (seen.id, seen.task.instruction) == (by_labels.id, by_labels.task.instruction)
    np.testing.assert_array_equal(seen.truth.cells, by_labels.truth.cells)
    assert by_labels.scene.objects
    assert not seen.scene.objects
    assert [region.label for region in seen.scene.regions.values()] == ["ground"]
