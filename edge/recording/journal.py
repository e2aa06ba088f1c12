"""The journal of a recording, as JSON: inputs of the loop, observations and decisions.

A page is one message of the journal: the inputs since the last page, and the observation and
decisions of the tick after them. docs/recording.md has the schema.

Numbers are exact to the last bit: arrays are base64, and JSON floats are the shortest that give the
same number.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from edge.config import Config
from edge.config.root import parse
from edge.geometry import SE2, CameraModel, Grid
from edge.host.checkpoint import Checkpoint
from edge.loop.checkpoints.map_checkpoint import MAP
from edge.loop.input_log import LoopInput
from edge.loop.result import TickResult
from edge.mapping.regions import RegionMap
from edge.memory import LostRoom, RoomSurvey, outline_rooms, site_of
from edge.mission.checkpoint import MISSION
from edge.mission.destinations import destinations_json, destinations_of_json
from edge.mission.logic import ltl
from edge.mission.repetition import Repetition
from edge.mission.translate import Translation
from edge.text import bounded_repr, read_json, redact
from edge.types import Detections, Goal, GoalStatus, Observation

FORMAT, VERSION = "edge-recording", 3
MAX_VALUES = 1 << 20
"""Largest number of JSON values in one message; a base64 array counts as one."""


@dataclass(frozen=True)
class JournalPage:
    """One message of the journal.

    Attributes:
        entries: inputs in order. In an entry of kind `result`, the field `result` stays JSON: the
            replay decodes it as the worker's type.
        observation: the observation without its arrays, as JSON; None: there was none.
        decisions: decisions that a replay compares; None: there were none.
    """

    entries: list[LoopInput]
    observation: dict[str, Any] | None
    decisions: dict[str, Any] | None


def encode_page(
    inputs: Iterable[LoopInput], result: TickResult, kept: Observation | None, rig: dict[str, Any]
) -> bytes:
    """Encode one page.

    Args:
        inputs: inputs since the last page.
        result: the newest result of these inputs.
        kept: observation of the result, with only the arrays that are recorded.
        rig: camera and mounts as last written, {} at first; changed in place.
    """
    page = {
        "entries": [
            {"n": entry.n, "kind": entry.kind, **_ENCODE[entry.kind](entry.fields)}
            for entry in inputs
        ],
        "observation": None if kept is None else _observation(kept, result.observation, rig),
        "decisions": decisions_of(result),
    }  # fmt: skip
    return _JSON(page).encode()


_JSON = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


def decode_page(payload: bytes) -> JournalPage:
    """Decode a page of `encode_page`.

    Raises:
        Exception: any, if the payload is damaged.
    """
    page = read_json(payload, MAX_VALUES)
    entries = []
    for entry in page["entries"]:
        n, kind = entry.pop("n"), entry.pop("kind")
        entries.append(LoopInput(n, kind, _DECODE[kind](entry)))
    return JournalPage(entries, page["observation"], _check_decisions(page["decisions"]))


_NO_GOAL = {"pose": (0.0, 0.0, 0.0), "score": 0.0, "kind": "", "id": 0, "target": ""}


def _check_decisions(decisions: dict[str, Any] | None) -> dict[str, Any] | None:
    """Raise an error for malformed decisions, which will be compared and printed."""
    if decisions is None:
        return None
    if missing := sorted({"target", "phase", "goal", "sent"} - decisions.keys()):
        raise ValueError(f"the recorded decisions lack {', '.join(missing)}")
    for goal in (decisions["goal"] or dict(_NO_GOAL), *decisions["sent"]):
        if not _NO_GOAL.keys() <= goal.keys() or len(goal["pose"]) != 3:
            raise ValueError("a recorded goal lacks a field, or its pose is not x, y, yaw")
        goal["pose"] = [float(v) for v in goal["pose"]]
        goal["score"] = float(goal["score"])
    return decisions


def decisions_of(result: TickResult) -> dict[str, Any] | None:
    """Return the decisions in a result, for comparison; None if there are none.

    The keys are `target`, `phase`, `goal` (the present one, or None) and `sent` (new goals).
    """
    if result.observation is None and not result.goals:
        return None
    return {
        "target": result.status.target,
        "phase": result.status.phase,
        "goal": None if result.goal is None else _goal(result.goal),
        "sent": [_goal(goal) for goal in result.goals],
    }


def _goal(goal: Goal) -> dict[str, Any]:
    return {
        "stamp": goal.stamp_ns, "kind": goal.kind, "id": goal.candidate_id,
        "target": goal.target, "pose": _pose(goal.pose),
        "candidate_xy_m": [float(v) for v in goal.candidate_xy_m], "score": float(goal.score),
    }  # fmt: skip


# -- observations ----------------------------------------------------------------------------------


def _observation(
    kept: Observation, original: Observation | None, rig: dict[str, Any]
) -> dict[str, Any]:
    """Encode an observation; camera and mounts only if they changed."""
    rgb = None if original is None else original.rgb
    stored = {
        "seq": kept.seq,
        "stamp_ns": kept.stamp_ns,
        "T_map_base": _array(kept.T_map_base),
        # The arrays are in other channels; here is only which of them there were.
        "rgb_hw": None if rgb is None else list(rgb.shape[:2]),
        "depth": original is not None and original.depth_m is not None,
        "cloud": original is not None and original.cloud_m is not None,
        "pose_age_ns": kept.pose_age_ns,
    }
    if kept.camera_index:
        stored["camera_index"] = kept.camera_index
    now = {
        "camera": kept.camera,
        "T_base_camera": kept.T_base_camera.tobytes(),
        "T_base_lidar": kept.T_base_lidar.tobytes(),
    }
    if now != rig:
        rig.update(now)
        stored["rig"] = {
            "camera": None if kept.camera is None else asdict(kept.camera),
            "T_base_camera": _array(kept.T_base_camera),
            "T_base_lidar": _array(kept.T_base_lidar),
        }
    return stored


def observation_of(
    stored: dict[str, Any],
    rig: dict[str, Any],
    rgb: np.ndarray | None,
    depth_m: np.ndarray | None,
    cloud_m: np.ndarray | None,
) -> Observation:
    """Decode an observation, with its recorded arrays.

    Args:
        stored: the observation as JSON.
        rig: camera and mounts as last read; changed in place.
        rgb: (h, w, 3) uint8, or None.
        depth_m: (h, w) float32, or None.
        cloud_m: (n, 3) float32, or None.
    """
    rig.update(stored.get("rig", {}))
    camera = rig["camera"]
    for name in ("seq", "stamp_ns"):
        if type(stored[name]) is not int or not 0 <= stored[name] < 1 << 63:
            raise ValueError(f"{name}: expected 0 or more, got {bounded_repr(stored[name], 40)}")
    return Observation(
        stored["seq"], stored["stamp_ns"], _array_of(stored["T_map_base"]), rgb, depth_m,
        None if camera is None else CameraModel(**camera), _array_of(rig["T_base_camera"]),
        cloud_m, _array_of(rig["T_base_lidar"]), pose_age_ns=int(stored["pose_age_ns"]),
        camera_index=int(stored.get("camera_index", 0)),
    )  # fmt: skip


# -- entries: `_x` encodes to JSON, `_x_of`, `x_of` or `decoded` decodes the stored JSON ----------


def _array(array: np.ndarray) -> dict[str, Any]:
    array = np.ascontiguousarray(array)
    data = base64.b64encode(array.tobytes()).decode()
    return {"dtype": array.dtype.str, "shape": list(array.shape), "base64": data}


def _array_of(stored: dict[str, Any]) -> np.ndarray:
    data = base64.b64decode(stored["base64"])
    return np.frombuffer(data, np.dtype(stored["dtype"])).reshape(stored["shape"]).copy()


def _plain(value: Any) -> Any:
    """Return JSON data: a dataclass as its fields, arrays as base64, a pose as x, y and yaw."""
    match value:
        case np.ndarray():
            return _array(value)
        case SE2():
            return _pose(value)
        case np.generic():
            return value.item()
        case frozenset():
            return sorted(value)
        case tuple() | list():
            return [_plain(item) for item in value]
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    return value


def decoded(kind: Any, stored: Any) -> Any:
    """Return the value of this type that `_plain` has encoded.

    Fields with a default may lack, and fields of an earlier version are ignored.

    Raises:
        Exception: any, if the value is damaged.
    """
    origin, inner = get_origin(kind), get_args(kind)
    if stored is None:
        return None
    if kind is np.ndarray:
        return _array_of(stored)
    if kind is SE2:
        return SE2(*stored)
    if origin in (Union, UnionType):
        (kind,) = (one for one in inner if one is not NoneType)
        return decoded(kind, stored)
    if origin is frozenset:
        return frozenset(stored)
    if origin is tuple:
        kinds = [inner[0]] * len(stored) if inner[1:] == (...,) else inner
        return tuple(decoded(one, item) for one, item in zip(kinds, stored, strict=True))
    if is_dataclass(kind):
        kinds = _types_of_fields(kind)
        known = {name: value for name, value in stored.items() if name in kinds}
        return kind(**{name: decoded(kinds[name], value) for name, value in known.items()})
    return stored


_types_of_fields = cache(get_type_hints)


def _pose(pose: SE2 | None) -> list[float] | None:
    return None if pose is None else [pose.x_m, pose.y_m, pose.yaw_rad]


def _translation(t: Translation) -> dict[str, Any]:
    return {
        "instruction": t.instruction, "formula": str(t.formula), "english": t.english,
        "backend": t.backend, "reading": t.reading, "readings": t.readings, "implied": t.implied,
        "destinations": destinations_json(t.destinations),
        "repeat": _plain(t.repeat),
    }  # fmt: skip


def _translation_of(stored: dict[str, Any]) -> Translation:
    return Translation(
        stored["instruction"], ltl.parse(stored["formula"]), stored["english"], stored["backend"],
        reading=stored["reading"], readings=tuple(stored["readings"]), implied=stored["implied"],
        destinations=destinations_of_json(stored["destinations"]),
        repeat=decoded(Repetition, stored["repeat"]),
    )  # fmt: skip


def _start(fields: dict[str, Any]) -> dict[str, Any]:
    """Encode the start of a service, with its checkpoints as base64."""
    mission, map_ = fields["mission_checkpoint"], fields["map_checkpoint"]
    files = {
        "mission_checkpoint": None if mission is None else MISSION.encode(Checkpoint(mission)),
        "map_checkpoint": None if map_ is None else MAP.encode(map_),
    }
    return {
        **fields,
        "site": fields["site"].geojson(),
        "translation": _translation(fields["translation"]),
        **{name: None if b is None else base64.b64encode(b).decode() for name, b in files.items()},
    }


def _start_of(stored: dict[str, Any]) -> dict[str, Any]:
    files = {name: _file_of(stored[name]) for name in ("mission_checkpoint", "map_checkpoint")}
    translation, site = _translation_of(stored["translation"]), site_of(stored["site"])
    return {**stored, "translation": translation, "site": site, **files}


def _file_of(stored: str | None) -> bytes | None:
    """Decode the content of a checkpoint file; None if there was none."""
    return None if stored is None else base64.b64decode(stored)


def _boxes(found: Detections) -> dict[str, Any]:
    stored = {f.name: getattr(found, f.name) for f in fields(found) if f.name != "observation"}
    if found.mask is not None:
        stored["mask"] = np.packbits(found.mask, axis=-1)
    return {"seq": found.observation.seq, **{name: _plain(v) for name, v in stored.items()}}


def detections_of(stored: dict[str, Any], observation: Observation) -> Detections:
    """Decode detections of this observation."""
    kinds = _types_of_fields(Detections)
    found = {name: decoded(kinds[name], stored[name]) for name in stored.keys() - {"seq"}}
    if found["mask"] is not None:
        found["mask"] = np.unpackbits(found["mask"], axis=-1).astype(np.bool_)
    return Detections(observation, **found)


def _rooms(found: RoomSurvey) -> dict[str, Any]:
    r = found.regions
    return {
        "cells": _array(r.grid.cells), "origin_xy_m": list(map(float, r.grid.origin_xy_m)),
        "resolution_m": r.grid.resolution_m, "wall": _array(r.wall), "label": _array(r.label),
        "n": int(r.n), "border": _array(r.border),
        "ids": _array(found.ids), "next_id": found.next_id, "lost": [list(x) for x in found.lost],
    }  # fmt: skip


def rooms_of(stored: dict[str, Any]) -> RoomSurvey:
    """Decode a survey of the rooms."""
    origin = stored["origin_xy_m"]
    grid = Grid(_array_of(stored["cells"]), (origin[0], origin[1]), stored["resolution_m"])
    wall, label = _array_of(stored["wall"]), _array_of(stored["label"])
    regions = RegionMap(grid, wall, label, stored["n"], _array_of(stored["border"]))
    lost = tuple(LostRoom(int(i), float(x), float(y)) for i, x, y in stored["lost"])
    return outline_rooms(regions, _array_of(stored["ids"]), stored["next_id"], lost)


# Name of a worker → encoder of its result.
_ENCODE_RESULT: dict[str, Callable[[Any], dict[str, Any]]] = {
    "detector": _boxes,
    "travel_cost": lambda distance_m: {"distance_m": _array(distance_m)},
    "rooms": _rooms,
    # Workers of scorers answer with (question, result); the question is not recorded.
    "similarity": lambda answer: _plain(answer[1]),
    "choice": lambda answer: _plain(answer[1]),
    "task": _plain,
}


def config_text(config: Config) -> dict[str, Any]:
    """Return a configuration as JSON without secrets."""
    return redact(config.model_dump(mode="json"))


# Keys of earlier versions, which every recording of theirs has.
_REMOVED = {"perception": ("voxel_m", "reject_radius_m"), "motion": ("stuck_s", "clearance_m")}


def config_of(stored: dict[str, Any]) -> Config:
    """Decode a configuration; raise ConfigError."""
    path = stored.pop("path", "<recording>")
    for section, keys in _REMOVED.items():
        for key in keys:
            (stored.get(section) or {}).pop(key, None)
    return parse(stored, path)


_UNCHANGED = dict  # copies the fields
# Kind of an entry → function that encodes, or decodes, its fields.
_ENCODE: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "start": _start,
    "tick": _UNCHANGED,
    "images": lambda fields: {"done": fields["done"]},
    "request": _UNCHANGED,
    "result": lambda fields: {
        "worker": fields["worker"], "result": _ENCODE_RESULT[fields["worker"]](fields["result"])
    },
    "decision": _UNCHANGED,
    "idle": lambda fields: {"now_ns": fields["now_ns"], "pose": _pose(fields["pose"])},
    "goal_status": lambda fields: asdict(fields["goal_status"]),
    "mission": lambda fields: {
        **fields, "translation": _translation(fields["translation"])
    },
    "pause": _UNCHANGED,
    "stop": _UNCHANGED,
    "cancel": _UNCHANGED,
    "confirm": _UNCHANGED,
    "fail": _UNCHANGED,
    "config": lambda fields: {"config": config_text(fields["config"])},
    "jump": _UNCHANGED,
    "site": lambda fields: {**fields, "site": fields["site"].geojson()},
}  # fmt: skip
_DECODE: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    **dict.fromkeys(_ENCODE, _UNCHANGED),
    "start": _start_of,
    "goal_status": lambda stored: {"goal_status": decoded(GoalStatus, stored)},
    "mission": lambda stored: {**stored, "translation": _translation_of(stored["translation"])},
    "config": lambda stored: {"config": config_of(stored["config"])},
    "site": lambda stored: {**stored, "site": site_of(stored["site"])},
    "idle": lambda stored: {
        "now_ns": stored["now_ns"], "pose": decoded(SE2, stored["pose"])
    },
}  # fmt: skip
