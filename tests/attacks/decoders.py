"""All decoders of network data, with a few valid messages for each."""

from __future__ import annotations

import ast
import json
import random
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from ros_messages import DOCK_FAREWELLS, FAREWELLS, STORE, UNDOCK_FAREWELLS, header, pose, to_ros
from ros_robots import LOCALIZED

import edge
from edge.bus.ros2.names import Endpoint, parse_token
from edge.bus.verbs import read_request
from edge.bus.wire import compressed, messages, navigation, transforms
from edge.cli.mission import as_text
from edge.geometry import SE2, CameraModel, Grid
from edge.lab.motion.process import parse_tick
from edge.loop.requests.handlers import mission_verbs
from edge.loop.requests.model_requests import MODEL_VERBS
from edge.sources.goal_status import parse_goal_status
from edge.sources.truth import parse_labels
from edge.sources.zmq import parse_header
from edge.text import read_json_object

NS = 1_700_000_000_123_456_789
POSE = SE2(1.0, 2.0, 0.5).matrix()
VERBS = {**mission_verbs(lambda **_: None), **MODEL_VERBS}
_RGB = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
_OUT = {
    "rgb": np.zeros((2, 4, 3), np.uint8),
    "depth": np.zeros((2, 4), np.float32),
    "ids": np.zeros((2, 4), np.uint16),
    "points": np.zeros((64, 3), np.float32),
}


@dataclass(frozen=True)
class Decoder:
    """Decoder under test.

    Attributes:
        reads: takes a payload, or raises ValueError with one line.
        seeds: valid payloads.
        covers: the functions of `edge` that it calls with the payload.
    """

    reads: Callable[[bytes], object]
    seeds: tuple[bytes, ...]
    covers: tuple[str, ...]


def _token(payload: bytes) -> Endpoint:
    if (found := parse_token(payload.decode("utf-8", "replace"))) is None:
        raise ValueError("no token")
    return found


def _image_into(out: np.ndarray) -> Callable[[bytes], object]:
    def read(payload: bytes) -> None:
        messages.decode_image_into(payload, messages.decode_image_header(payload), out)

    return read


def _json(*said: object) -> tuple[bytes, ...]:
    return tuple(json.dumps(one).encode() for one in said)


def _compressed_into(out: np.ndarray) -> Callable[[bytes], object]:
    def read(payload: bytes) -> None:
        found = compressed.decode_compressed_header(payload)
        if (found.height, found.width) != out.shape[:2]:
            raise ValueError(f"{found.width}x{found.height}")
        compressed.decode_compressed_into(payload, found, out)

    return read


def _ros(name: str, *values: object) -> bytes:
    return to_ros(STORE.types[name](*values))


def _picture(words: str, kind: str, array: np.ndarray) -> bytes:
    data = cv2.imencode(kind, array)[1].reshape(-1)
    return _ros("sensor_msgs/msg/CompressedImage", header(NS, "c"), words, data)


def _goal_info() -> object:
    uuid = STORE.types["unique_identifier_msgs/msg/UUID"](np.arange(16, dtype=np.uint8))
    time = STORE.types["builtin_interfaces/msg/Time"](1, 2)
    return STORE.types["action_msgs/msg/GoalInfo"](uuid, time)


def _feedback() -> bytes:
    lasted = STORE.types["builtin_interfaces/msg/Duration"](1, 0)
    at = STORE.types["geometry_msgs/msg/PoseStamped"](header(NS, "map"), pose(SE2(1.0, 2.0, 0.5)))
    inner = STORE.types["nav2_msgs/msg/NavigateToPose_Feedback"](at, lasted, lasted, 1, 2.5)
    return _ros("nav2_msgs/msg/NavigateToPose_FeedbackMessage", _goal_info().goal_id, inner)


_COMPRESSED = ("decode_compressed_header", "decode_compressed_into")
_IMAGE = ("decode_image_header", "decode_image_into")
_DEPTH = np.arange(8, dtype=np.float32).reshape(2, 4)

DECODERS = {
    "rgb": Decoder(_image_into(_OUT["rgb"]), (messages.encode_image(NS, "c", _RGB),), _IMAGE),
    "depth": Decoder(
        _image_into(_OUT["depth"]),
        (
            messages.encode_image(NS, "c", _DEPTH),
            messages.encode_image(NS, "c", _DEPTH.astype(np.uint16)),
        ),
        _IMAGE,
    ),
    "segmentation": Decoder(
        _image_into(_OUT["ids"]),
        (messages.encode_image(NS, "c", _DEPTH.astype(np.uint16)),),
        _IMAGE,
    ),
    "camera info": Decoder(
        messages.decode_camera_info,
        (messages.encode_camera_info(NS, "c", CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)),),
        ("decode_camera_info",),
    ),
    "cloud": Decoder(
        lambda payload: messages.decode_point_cloud_into(payload, _OUT["points"]),
        (messages.encode_point_cloud(NS, "l", np.ones((5, 3), np.float32)),),
        ("decode_point_cloud_into",),
    ),
    "scan": Decoder(
        lambda payload: messages.decode_scan_points_into(payload, _OUT["points"], free=True),
        (messages.encode_laser_scan(NS, "l", -1.0, 0.5, 9.0, np.ones(5, np.float32)),),
        ("decode_scan_points_into", "decode_laser_scan"),
    ),
    "odometry": Decoder(
        messages.decode_odometry,
        (messages.encode_odometry(NS, POSE, 0.1, 0.2),),
        ("decode_odometry",),
    ),
    "goal": Decoder(
        messages.decode_pose_stamped,
        (messages.encode_pose_stamped(NS, SE2(1.0, 2.0, 0.5)),),
        ("decode_pose_stamped",),
    ),
    "velocity": Decoder(
        messages.decode_twist_stamped,
        (messages.encode_twist_stamped(NS, 0.1, 0.2),),
        ("decode_twist_stamped",),
    ),
    "map": Decoder(
        messages.decode_occupancy_grid,
        (messages.encode_occupancy_grid(NS, Grid(np.zeros((3, 4), np.int8), (0.0, 0.0), 0.05)),),
        ("decode_occupancy_grid",),
    ),
    "stamp": Decoder(
        messages.peek_stamp_ns, (messages.encode_twist_stamped(NS, 0.1, 0.2),), ("peek_stamp_ns",)
    ),
    "compressed rgb": Decoder(
        _compressed_into(_OUT["rgb"]),
        (_picture("jpeg", ".jpg", _RGB), _picture("rgb8; png compressed bgr8", ".png", _RGB)),
        _COMPRESSED,
    ),
    "compressed depth": Decoder(
        _compressed_into(_OUT["depth"]),
        (_picture("16UC1; png compressed", ".png", _DEPTH.astype(np.uint16)),),
        _COMPRESSED,
    ),
    "tf": Decoder(transforms.decode_transforms, (LOCALIZED,), ("decode_transforms",)),
    "goal answer": Decoder(
        navigation.decode_send_goal_answer,
        (_ros("nav2_msgs/msg/NavigateToPose_SendGoal_Response", True, _goal_info().stamp),),
        ("decode_send_goal_answer",),
    ),
    "goal result": Decoder(
        navigation.decode_result,
        tuple(encode(6, 103, "no way") for encode, _ in FAREWELLS.values()),
        ("decode_result",),
    ),
    "dock result": Decoder(
        lambda payload: navigation.decode_result(payload, has_success=True, has_retries=True),
        tuple(encode(6, 903, "no way") for encode, _ in DOCK_FAREWELLS.values()),
        ("decode_result",),
    ),
    "undock result": Decoder(
        lambda payload: navigation.decode_result(payload, has_success=True),
        tuple(encode(6, 903, "no way") for encode, _ in UNDOCK_FAREWELLS.values()),
        ("decode_result",),
    ),
    "goal feedback": Decoder(navigation.decode_feedback, (_feedback(),), ("decode_feedback",)),
    "goal statuses": Decoder(
        navigation.decode_goal_statuses,
        (
            _ros(
                "action_msgs/msg/GoalStatusArray",
                [STORE.types["action_msgs/msg/GoalStatus"](_goal_info(), 4)],
            ),
        ),
        ("decode_goal_statuses",),
    ),
    "header": Decoder(
        messages.peek_header, (messages.encode_twist_stamped(NS, 0.1, 0.2),), ("peek_header",)
    ),
    "goal status": Decoder(
        parse_goal_status,
        _json(
            {"stamp": NS, "state": "failed", "reason": "stuck", "blocked": [1.5, -2]},
            {"stamp": NS, "state": "reached"},
        ),
        ("parse_goal_status",),
    ),
    "labels": Decoder(parse_labels, _json([], ["chair", "tv stand"]), ("parse_labels",)),
    "tick": Decoder(parse_tick, _json({"stamp": NS}), ("parse_tick",)),
    "ZeroMQ header": Decoder(
        lambda payload: parse_header(payload, 24),
        _json(
            {
                "topic": "camera/rgb",
                "encoding": "rgb8",
                "stamp": NS,
                "height": 2,
                "width": 4,
                "intrinsics": [3.0, 3.0, 1.5, 0.5],
            }
        ),
        (),
    ),
    "token": Decoder(
        _token,
        (b"@ros2_lv/0/a1/1/2/MP/%/%/nav/%map/nav_msgs::msg::dds_::Path_/RIHS01_0/::,10:,:,:,,",),
        (),
    ),
    "request": Decoder(
        lambda payload: read_request(payload, VERBS),
        _json(
            {"do": "new", "instruction": "find the bed"},
            {"do": "new", "formula": "F bed"},
            {"do": "use", "model": "mine", "force": True},
            {"do": "pause"},
        ),
        ("read_request",),
    ),
    "answer": Decoder(
        lambda payload: as_text(read_json_object(payload)),
        _json({"phase": "running", "state": 1, "states": 3, "plan": ["bed"], "overtaken": 2}),
        (),
    ),
}


def readers_of_payloads() -> set[str]:
    """Return the public functions of `edge` whose first parameter is a `payload`.

    It leaves out `recording`, which reads its own files, and `lab/eval/soak`.
    """
    found, root = set(), Path(edge.__file__).parent
    own = {*root.glob("recording/*.py"), *root.glob("lab/eval/soak/*.py")}
    for path in set(root.rglob("*.py")) - own:
        source = path.read_text(encoding="utf-8")
        for node in ast.parse(source).body if "payload" in source else ():
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                names = [argument.arg for argument in node.args.args[:1]]
                if names == ["payload"]:
                    found.add(node.name)
    return found


_LENGTHS = (0, 1, 2, 3, 7, 255, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 8, 2**32 - 1)
_FLOATS = (0.0, -0.0, 1e-310, 1e38, 1e300, float("inf"), float("-inf"), float("nan"))
_WORDS = (
    b"null", b"NaN", b"-Infinity", b"1e999", b"[" * 2000, b'{"a":' * 500, b'"\\ud800"', b"\xff",
    b"true", b"[]", b"{}", b'""', b"-", b"1" * 5000, b'\\u0000"', b'"stamp":', b'"do":',
)  # fmt: skip


def mutate(payload: bytes, chance: random.Random) -> bytes:
    """One to four changes that fuzzers are known to make."""
    changed = bytearray(payload)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(changed) + 1)
        match chance.randrange(7):
            case 0 if at < len(changed):
                changed[at] ^= 1 << chance.randrange(8)
            case 1 if at < len(changed):
                changed[at] = chance.randrange(256)
            case 2:
                changed[at & ~3 : (at & ~3) + 4] = struct.pack("<I", chance.choice(_LENGTHS))
            case 3:
                # CDR aligns after its header of 4 bytes.
                begin = 4 + ((at - 4) & ~7)
                changed[begin : begin + 8] = struct.pack("<d", chance.choice(_FLOATS))
            case 4:
                del changed[at:]
            case 5:
                changed[at:at] = chance.choice(_WORDS)
            case _:
                end = min(at + chance.randrange(16), len(changed))
                changed[at:at] = changed[at:end]
    return bytes(changed)


def lengths_that_lie(payload: bytes) -> Iterator[bytes]:
    """Yield the payload with each of its 32-bit words as a huge number."""
    for at in range(4, len(payload) - 3, 4):
        for huge in (2**31 - 1, 2**32 - 1, 2**27):
            yield payload[:at] + struct.pack("<I", huge) + payload[at + 4 :]
