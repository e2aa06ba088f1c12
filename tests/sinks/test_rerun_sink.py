"""The sink `rerun`: its file, as Rerun reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from patience import eventually
from results import CELLS, result
from simulated import simulated

from edge.config import ConfigError
from edge.geometry import SE2, CameraModel
from edge.loop.result import Event
from edge.sinks import find_sinks
from edge.types import Detections, Goal, Observation

rerun = pytest.importorskip("rerun", reason="the extra [rerun] is not installed")

CAMERA = CameraModel(40, 30, 30.0, 30.0, 20.0, 15.0)
SECOND = 1_000_000_000


def make(**options: Any) -> Any:
    config = simulated({"sinks": [{"kind": "rerun", "options": options}]})
    (factory,) = find_sinks(config)
    return factory(config=config, session=None)


def read(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of each entity; a row has the values by component."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for chunk in rerun.chunk.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        columns = [
            (column.cast("int64") if "timestamp" in str(column.type) else column).to_pylist()
            for column in batch.columns
        ]
        rows.setdefault(str(chunk.entity_path), []).extend(
            dict(zip(batch.schema.names, row, strict=True)) for row in zip(*columns, strict=True)
        )
    return rows


def seen(camera_index: int = 0, stamp_ns: int = 0, **more: Any) -> Observation:
    rgb, T = np.full((30, 40, 3), 90, np.uint8), np.eye(4)
    T[:3, 3] = 0.2, 0.0, 0.5
    return Observation(
        0, stamp_ns, SE2(1.0, 2.0, 0.0).matrix(), rgb=rgb, camera=CAMERA, T_base_camera=T,
        camera_index=camera_index, **more,
    )  # fmt: skip


def test_without_a_tick_the_file_is_complete(tmp_path):
    sink = make(file=str(tmp_path / "a.rrd"))
    sink.close()
    assert set(read(tmp_path / "a.rrd")) == {"/map", "/__properties"}


def test_a_tick_of_each_camera(tmp_path):
    sink = make(file=str(tmp_path / "a.rrd"))
    box = np.array([[1, 2, 11, 12]], np.float32)
    goal = Goal(5, SE2(3.0, 2.0, 0.0), "frontier", 1, (3.0, 2.0), 0.5, "chair")
    for i, observation in enumerate((seen(), seen(1))):
        found = Detections(
            observation, box, np.ones(1, np.float32), np.zeros(1, np.int32), ("chair",)
        )
        sink.tick(result(
            i * SECOND, observation=observation, pose=observation.pose, detections=found,
            goal=goal, events=(Event(i, f"event\n{i}"),),
        ))  # fmt: skip
    sink.close()
    rows = read(tmp_path / "a.rrd")
    for camera in ("camera", "camera2"):
        (image,) = rows[f"/map/robot/{camera}/image"]
        assert bytes(image["EncodedImage:blob"][0]).startswith(b"\xff\xd8")
        (boxes,) = rows[f"/map/robot/{camera}/boxes"]
        assert boxes["Boxes2D:labels"] == ["chair 1.00"]
        assert boxes["Boxes2D:half_sizes"] == [[5.0, 5.0]]
    (robot, *_) = rows["/map/robot"]
    assert robot["Transform3D:translation"] == [[1.0, 2.0, 0.0]]
    assert [row["time"] for row in rows["/events"]] == [0, SECOND]
    grid = rows["/map/grid"][0]
    # Rerun's first row has the highest y; ours has the lowest.
    blob = np.frombuffer(bytes(grid["GridMap:data"][0]), np.int8)
    np.testing.assert_array_equal(blob.reshape(CELLS.shape), CELLS[::-1])
    assert grid["GridMap:translation"] == [[-1.0, 2.0, 0.0]]
    assert rows["/map/goal"][0]["Arrows3D:origins"] == [[3.0, 2.0, 0.0]]


def test_images_are_limited_to_their_rate(tmp_path):
    for rgb_hz, images in ((2.0, 3), (0, 0)):
        path = tmp_path / f"{rgb_hz}.rrd"
        sink = make(file=str(path), rgb_hz=rgb_hz)
        for k in range(11):  # 1 s
            sink.tick(result(k * SECOND // 10, observation=seen()))
        sink.close()
        assert len(read(path).get("/map/robot/camera/image", ())) == images


def test_the_file_ends_at_its_size_limit(tmp_path, caplog):
    sink = make(file=str(tmp_path / "a.rrd"), max_mb=1)
    noise = np.random.default_rng(0).integers(0, 255, (480, 640, 3)).astype(np.uint8)

    def is_full() -> bool:
        is_full.k += 1
        observation = Observation(0, 0, np.eye(4), rgb=noise, camera=CAMERA)
        sink.tick(result(is_full.k * SECOND, observation=observation))
        return sink.status()["problem"] != ""

    is_full.k = 0
    eventually(is_full)
    size = (tmp_path / "a.rrd").stat().st_size
    sink.tick(result(10**6 * SECOND, observation=seen()))
    sink.close()
    assert 1e6 <= size <= 20e6
    assert "has max_mb: nothing more is written" in caplog.text
    assert read(tmp_path / "a.rrd")["/map/robot"]


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"file": "a.txt"}, "sinks: rerun: file: expected a name in .rrd, got 'a.txt'"),
        ({"file": 3}, "sinks.0.options.file: expected a text, got 3"),
        ({"max_mb": 0}, "sinks: rerun: max_mb: expected a number, 1 or more, got 0"),
        ({"rgb_hz": float("nan")}, "sinks: rerun: rgb_hz: expected a number, 0 or more, got nan"),
        ({"rgb_hz": True}, "sinks.0.options.rgb_hz: expected a number, got True"),
        ({"file": "/proc/no/a.rrd"}, "sinks: rerun: file: /proc/no/a.rrd: cannot be written: No"),
    ],
)
def test_bad_options_get_one_line(options, why):
    with pytest.raises(ConfigError) as caught:
        make(**options)
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)
