"""Messages of the sink `mcap`: ROS 2 types, exact depth, bounded memory."""

from __future__ import annotations

import json
import threading

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from patience import eventually
from recordings import Recording, small
from results import result
from ros_messages import from_ros
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from task_facts import driving, looking, written

from edge.errors import ConfigError
from edge.geometry import SE2, CameraModel
from edge.loop.result import Event
from edge.recording import channels
from edge.recording.file import McapReader
from edge.recording.rolling import files_of
from edge.recording.session import RecordedRun
from edge.sinks import find_sinks, mcap
from edge.sinks.mcap import McapSink
from edge.types import Goal, Observation

CAMERA = CameraModel(40, 30, 30.0, 30.0, 20.0, 15.0)


def seen(seq: int, depth_m: np.ndarray | None = None, **fields) -> Observation:
    return Observation(
        seq, seq * 10**8, SE2(1.0, 2.0, 0.5).matrix(), depth_m=depth_m, camera=CAMERA, **fields
    )


def tick(observation: Observation, **fields):
    return result(observation.stamp_ns, observation=observation, **fields)


@pytest.fixture
def make(tmp_path):
    made: list[McapSink] = []

    def sink(lockstep: bool = True, **options) -> McapSink:
        made.append(McapSink(small(loop={"lockstep": lockstep}), str(tmp_path), **options))
        return made[-1]

    yield sink
    for one in made:
        one.close()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run a drive in two rooms, with a camera and a LiDAR."""
    config = small(sensors={"camera": {"width_px": 80, "height_px": 64},
                            "lidar": {"rings": 4, "columns": 90}})  # fmt: skip
    return Recording(tmp_path_factory.mktemp("run"), config, rgb_hz=100.0).steps(15).close()


def test_every_message_decodes_with_its_schema(run):
    with open(run, "rb") as file:
        newest = {c.topic: (s, m.data) for s, c, m in make_reader(file).iter_messages()}
    read = {}
    for topic, (schema, payload) in newest.items():
        if schema.encoding == "ros2msg":
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(schema.data.decode(), schema.name))
            read[topic] = store.deserialize_cdr(payload, schema.name)
    assert read.keys() == {
        "/camera/rgb/compressed", "/camera/depth", "/camera/info", "/lidar/points", "/odom", "/tf",
        "/goal", "/map", "/path", "/markers",
    }  # fmt: skip
    assert [t.child_frame_id for t in read["/tf"].transforms] == [
        "base_link", "camera_optical", "lidar",
    ]  # fmt: skip
    picture = cv2.imdecode(read["/camera/rgb/compressed"].data, cv2.IMREAD_COLOR)
    assert picture.shape == (64, 80, 3)
    assert read["/odom"].pose.pose.orientation.w != 0.0
    assert len(read["/path"].poses) >= 1
    assert {m.ns for m in read["/markers"].markers} >= {"frontiers"}
    assert read["/map"].info.resolution > 0.0


def test_json_messages_have_the_fields_of_foxglove(run):
    said: dict[str, dict] = {}
    schemas = {}
    for m in McapReader(run):
        if m.encoding == "json":
            said[m.topic], schemas[m.topic] = json.loads(m.payload), m.schema
    assert schemas["/events"] == "foxglove.Log"
    assert schemas["/detections"] == "foxglove.ImageAnnotations"
    for channel in (channels.EVENTS, channels.BOXES):
        known = json.loads(channel.schema_text)["properties"]
        assert said[channel.topic].keys() == known.keys()
    assert said["/status"]["phase"] == "searching"
    assert said["/latency"]["tick"]["n"] > 0


def test_a_trajectory_is_recorded_on_change_and_periodically(make, tmp_path):
    sink = make()
    at_s = {0: None, 1: looking(), 2: driving(0), 3: driving(9), 8: driving(10), 9: None, 20: None}
    for now_s, task in at_s.items():
        sink.tick(tick(seen(10 * now_s), task=lambda task=task: task))
    sink.close()
    told = [m for m in McapReader(files_of(tmp_path)[0]) if m.topic == "/trajectory"]
    paths = [from_ros(m.payload, "nav_msgs/msg/Path") for m in told]
    n = len(written()[1].poses)
    assert [(p.header.stamp.sec, len(p.poses)) for p in paths] == [(2, n), (8, n), (9, 0)]


@pytest.mark.parametrize(
    ("depth_m", "encoding"),
    [
        (np.zeros((30, 40), np.float32), b"16UC1"),
        (np.arange(1200, dtype=np.uint16).reshape(30, 40) * np.float32(0.001), b"16UC1"),
        (np.full((30, 40), 65.535, np.float32), b"16UC1"),
        (np.full((30, 40), 65.536, np.float32), b"32FC1"),
        (np.full((30, 40), np.pi, np.float32), b"32FC1"),
        (np.full((30, 40), np.nan, np.float32), b"32FC1"),
        (np.full((30, 40), -0.001, np.float32), b"32FC1"),
    ],
)
def test_depth_survives_a_round_trip_exactly(make, tmp_path, depth_m, encoding):
    sink = make()
    sink.tick(tick(seen(1, depth_m)))
    sink.close()
    path = files_of(tmp_path)[0]
    (payload,) = [m.payload for m in McapReader(path) if m.topic == "/camera/depth"]
    assert encoding in payload
    (moment,) = RecordedRun(path).steps()
    np.testing.assert_array_equal(moment.observation.depth_m, depth_m)
    assert moment.observation.T_map_base.tobytes() == seen(1).T_map_base.tobytes()
    assert moment.observation.camera == CAMERA


def test_a_cloud_survives_a_round_trip_with_empty_beams(make, tmp_path):
    cloud_m = np.array([[1.0, 2.0, 3.0], [4.0, 0.0, np.inf]], np.float32)
    sink = make()
    sink.tick(tick(seen(1, cloud_m=cloud_m)))
    sink.close()
    path = files_of(tmp_path)[0]
    (payload,) = [m.payload for m in McapReader(path) if m.topic == "/lidar/points"]
    assert not from_ros(payload, "sensor_msgs/msg/PointCloud2").is_dense
    (moment,) = RecordedRun(path).steps()
    np.testing.assert_array_equal(moment.observation.cloud_m, cloud_m)


def test_frames_are_copied_before_the_source_reuses_them(make, tmp_path):
    sink, depth_m = make(lockstep=False), np.ones((30, 40), np.float32)
    for k in range(1, 4):
        depth_m[:] = k
        sink.tick(tick(seen(k, depth_m)))
    depth_m[:] = 0.0
    sink.close()
    moments = RecordedRun(files_of(tmp_path)[0]).steps()
    assert [float(m.observation.depth_m[0, 0]) for m in moments] == [1.0, 2.0, 3.0]


def test_a_hanging_disk_drops_images_but_bounds_memory(make, tmp_path, monkeypatch):
    monkeypatch.setattr(mcap, "PENDING_BYTES", 50_000)
    sink = make(lockstep=False)
    gate, add = threading.Event(), sink._files.add
    sink._files.add = lambda *told, **more: (gate.wait(20.0), add(*told, **more))
    depth_m = np.ones((30, 40), np.float32)  # 2400 bytes as millimetres
    for k in range(1, 31):
        sink.tick(tick(seen(k, depth_m)))
    assert sink.status()["dropped"] == sink.status()["dropped_of"]["arrays"] == 9
    assert sink._pending_bytes <= 55_000
    gate.set()
    eventually(lambda: sink._pending_bytes == 0)
    sink.tick(tick(seen(31, depth_m)))
    sink.close()
    session = RecordedRun(files_of(tmp_path)[0])
    assert len(list(session.steps())) == 21
    assert session.gap == "the next frame's depth was dropped while recording"
    written = [m.sequence for m in session.messages() if m.topic == "/camera/depth"]
    assert written == [*range(1, 22), 31]


def test_ticks_between_observations_share_a_page(make, tmp_path):
    sink = make()
    for k in range(100):
        sink.tick(result(k * 10**7))
    sink.tick(result(10**9, events=(Event(10**9, "look"),)))
    goal = Goal(5, SE2(1.0, 2.0, 0.5), "frontier", 7, (1.0, 2.5), 0.4, "chair")
    sink.tick(result(10**9 + 1, goals=(goal,)))
    sink.close()
    topics = [m.topic for m in McapReader(files_of(tmp_path)[0])]
    assert topics.count("/journal") == 3
    assert (topics.count("/events"), topics.count("/goal")) == (1, 1)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"max_mb": 0}, "max_mb: must be more than 0, got 0"),
        ({"rgb_hz": -1}, "rgb_hz: must be 0 or more"),
        ({"keep_mb": 100}, "keep_mb: 100 is less than two files of max_mb, 256 MB"),
        ({"compression": "gzip"}, r"compression: unknown 'gzip' \(choices: none, lz4, zstd\)"),
        ({"color": "red"}, "options.color: unknown option"),
        ({"folder": "/proc/nowhere"}, "folder: /proc/nowhere: cannot be written: No such file"),
    ],
)
def test_options_that_cannot_be_used(tmp_path, options, why):
    config = small()
    sinks = ({"kind": "mcap", "options": {"folder": str(tmp_path), **options}},)
    config = type(config).model_validate({**config.model_dump(), "sinks": sinks})
    with pytest.raises(ConfigError, match=why):
        [make(config=config, session=None) for make in find_sinks(config)]
