"""The journal of a recording, as JSON: inputs of the loop, observations and decisions.

docs/recording.md has the schema. Numbers are exact to the last bit: arrays are base64, and JSON
floats are the shortest that give the same number.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from edge.config import Config
from edge.config.root import parse
from edge.geometry import SE2, CameraModel, Grid
from edge.host.checkpoint import Checkpoint
from edge.loop.behaviours.plan_worker import PlanResult
from edge.loop.input_log import LoopInput
from edge.loop.map_checkpoint import MAP
from edge.loop.result import TickResult
from edge.mapping.regions import RegionMap
from edge.memory import LostRoom, RoomSurvey, Site, outline_rooms, site_of
from edge.mission.checkpoint import MISSION
from edge.mission.destinations import destinations_json, destinations_of_json
from edge.mission.logic import ltl
from edge.mission.repetition import Repetition
from edge.mission.translate import Translation
from edge.perception.scoring.choice.question import FrontierChoice
from edge.policies.base import ImageSimilarity
from edge.recording.version1 import present_page
from edge.tasks.legs import Leg
from edge.tasks.refine import RefinedTrajectory
from edge.tasks.write import PlanAttempt
from edge.text import bounded_repr, read_json, redact
from edge.types import ContextBoxes, Detections, Goal, GoalStatus, Observation

FORMAT, VERSION = "edge-recording", 2
VERSIONS = ("1", "2")
"""Versions that can be read."""
MAX_VALUES = 1 << 20
"""Largest number of JSON values in one message; a base64 array counts as one."""


@dataclass(frozen=True)
class JournalPage:
    """One message of the journal.

    Attributes:
        entries: inputs in order. In an entry of kind `result`, the field `result` stays JSON.
        observation: the observation without its arrays, as JSON; None: there was none.
        decisions: decisions that a replay compares; None: there were none.
    """

    entries: list[LoopInput]
    observation: dict[str, Any] | None
    decisions: dict[str, Any] | None


def encode_page(
    inputs: Iterable[LoopInput], result: TickResult, seen: Observation | None, rig: dict[str, Any]
) -> bytes:
    """Encode one page.

    Args:
        inputs: inputs since the last page.
        result: the newest result of these inputs.
        seen: observation of the result, with only the arrays that are recorded.
        rig: camera and mounts as last written, empty at first; changed in place.
    """
    page = {
        "entries": [
            {"n": i.n, "kind": i.kind, **_ENCODE[i.kind](i.fields)} for i in inputs
        ],
        "observation": None if seen is None else _observation(seen, result.observation, rig),
        "decisions": decisions_of(result),
    }  # fmt: skip
    return _JSON(page).encode()


_JSON = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


def decode_page(payload: bytes) -> JournalPage:
    """Decode a page of `encode_page`.

    Raises:
        Exception: any, if the payload is damaged.
    """
    page = present_page(read_json(payload, MAX_VALUES))
    entries = []
    for entry in page["entries"]:
        n, kind = entry.pop("n"), entry.pop("kind")
        entries.append(LoopInput(n, kind, _DECODE[kind](entry)))
    return JournalPage(entries, page["observation"], _check_decisions(page["decisions"]))


_NO_GOAL = {"pose": (0.0, 0.0, 0.0), "score": 0.0, "kind": "", "id": 0, "target": ""}


def _check_decisions(said: dict[str, Any] | None) -> dict[str, Any] | None:
    """Raise an error for malformed decisions, which will be compared and printed."""
    if said is None:
        return None
    if missing := sorted({"target", "phase", "goal", "sent"} - said.keys()):
        raise ValueError(f"the recorded decisions lack {', '.join(missing)}")
    for goal in (said["goal"] or dict(_NO_GOAL), *said["sent"]):
        if not _NO_GOAL.keys() <= goal.keys() or len(goal["pose"]) != 3:
            raise ValueError("a recorded goal lacks a field, or its pose is not x, y, yaw")
        goal["pose"] = [float(v) for v in goal["pose"]]
        goal["score"] = float(goal["score"])
    return said


def decisions_of(result: TickResult) -> dict[str, Any] | None:
    """Return the decisions in a result, for comparison; None if there are none."""
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
    seen: Observation, whole: Observation | None, rig: dict[str, Any]
) -> dict[str, Any]:
    said = {
        "seq": seen.seq,
        "stamp_ns": seen.stamp_ns,
        "T_map_base": _array(seen.T_map_base),
        "rgb_hw": None if whole is None or whole.rgb is None else list(whole.rgb.shape[:2]),
        "depth": whole is not None and whole.depth_m is not None,
        "cloud": whole is not None and whole.cloud_m is not None,
        "pose_age_ns": seen.pose_age_ns,
    }
    now = {
        "camera": seen.camera,
        "T_base_camera": seen.T_base_camera.tobytes(),
        "T_base_lidar": seen.T_base_lidar.tobytes(),
    }
    if now != rig:
        rig.update(now)
        said["rig"] = {
            "camera": None if seen.camera is None else asdict(seen.camera),
            "T_base_camera": _array(seen.T_base_camera),
            "T_base_lidar": _array(seen.T_base_lidar),
        }
    return said


def observation_of(
    said: dict[str, Any],
    rig: dict[str, Any],
    rgb: np.ndarray | None,
    depth_m: np.ndarray | None,
    cloud_m: np.ndarray | None,
) -> Observation:
    """Decode an observation, with its recorded arrays.

    Args:
        said: the observation as JSON.
        rig: camera and mounts as last read; changed in place.
        rgb: (h, w, 3) uint8, or None.
        depth_m: (h, w) float32, or None.
        cloud_m: (n, 3) float32, or None.
    """
    rig.update(said.get("rig", {}))
    camera = rig["camera"]
    for name in ("seq", "stamp_ns"):
        if type(said[name]) is not int or not 0 <= said[name] < 1 << 63:
            raise ValueError(f"{name}: expected 0 or more, got {bounded_repr(said[name], 40)}")
    return Observation(
        said["seq"], said["stamp_ns"], _array_of(said["T_map_base"]), rgb, depth_m,
        None if camera is None else CameraModel(**camera), _array_of(rig["T_base_camera"]),
        cloud_m, _array_of(rig["T_base_lidar"]), pose_age_ns=int(said.get("pose_age_ns", 0)),
    )  # fmt: skip


# -- entries: `_x` encodes, `_x_of` or `x_of` decodes --------------------------------------------


def _array(array: np.ndarray) -> dict[str, Any]:
    array = np.ascontiguousarray(array)
    data = base64.b64encode(array.tobytes()).decode()
    return {"dtype": array.dtype.str, "shape": list(array.shape), "base64": data}


def _array_of(said: dict[str, Any]) -> np.ndarray:
    data = base64.b64decode(said["base64"])
    return np.frombuffer(data, np.dtype(said["dtype"])).reshape(said["shape"]).copy()


def _pose(pose: SE2 | None) -> list[float] | None:
    return None if pose is None else [pose.x_m, pose.y_m, pose.yaw_rad]


def _translation(t: Translation) -> dict[str, Any]:
    return {
        "instruction": t.instruction, "formula": str(t.formula), "english": t.english,
        "backend": t.backend, "reading": t.reading, "readings": t.readings, "implied": t.implied,
        "destinations": destinations_json(t.destinations),
        "repeat": None if t.repeat is None else asdict(t.repeat),
    }  # fmt: skip


def _translation_of(said: dict[str, Any]) -> Translation:
    return Translation(
        said["instruction"], ltl.parse(said["formula"]), said["english"], said["backend"],
        reading=said.get("reading"), readings=tuple(said.get("readings", ())),
        implied=said.get("implied", False),
        destinations=destinations_of_json(said.get("destinations", said.get("places", {}))),
        repeat=None if said.get("repeat") is None else Repetition(**said["repeat"]),
    )  # fmt: skip


def _start(fields: dict[str, Any]) -> dict[str, Any]:
    saved, known = fields["mission_checkpoint"], fields["map_checkpoint"]
    files = {
        "mission_checkpoint": None if saved is None else MISSION.encode(Checkpoint(saved)),
        "map_checkpoint": None if known is None else MAP.encode(known),
    }
    return {
        **fields,
        "site": fields["site"].geojson(),
        "translation": _translation(fields["translation"]),
        **{name: None if b is None else base64.b64encode(b).decode() for name, b in files.items()},
    }


def _start_of(said: dict[str, Any]) -> dict[str, Any]:
    files = {name: _file_of(said[name]) for name in ("mission_checkpoint", "map_checkpoint")}
    site = site_of(said["site"]) if "site" in said else Site()
    return {**said, "translation": _translation_of(said["translation"]), "site": site, **files}


def _file_of(said: str | None) -> bytes | None:
    if said is None or said.startswith("{"):  # JSON of a mission, written by older versions
        return said and said.encode()
    return base64.b64decode(said)


def _boxes(found: Detections) -> dict[str, Any]:
    c = found.context
    return {
        "seq": found.observation.seq,
        "xyxy_px": _array(found.xyxy_px), "score": _array(found.score),
        "class_id": _array(found.class_id), "prompts": list(found.prompts),
        "competing_score": None if found.competing_score is None else _array(found.competing_score),
        "context": None if c is None else {
            "xyxy_px": _array(c.xyxy_px), "score": _array(c.score),
            "class_id": _array(c.class_id), "words": list(c.words),
        },
        "model": found.model, "latency_ns": found.latency_ns,
        "mask": None if found.mask is None else _array(np.packbits(found.mask, axis=-1)),
    }  # fmt: skip


def detections_of(said: dict[str, Any], observation: Observation) -> Detections:
    """Decode detections of this observation."""
    c, competing = said["context"], said["competing_score"]
    return Detections(
        observation, _array_of(said["xyxy_px"]), _array_of(said["score"]),
        _array_of(said["class_id"]), tuple(said["prompts"]),
        None if competing is None else _array_of(competing),
        None if c is None else ContextBoxes(
            _array_of(c["xyxy_px"]), _array_of(c["score"]), _array_of(c["class_id"]),
            tuple(c["words"]),
        ),
        said["model"], said["latency_ns"], _masks_of(said.get("mask")),
    )  # fmt: skip


def _masks_of(said: dict[str, Any] | None) -> np.ndarray | None:
    """Decode masks; None if there are none, as in older recordings."""
    return None if said is None else np.unpackbits(_array_of(said), axis=-1).astype(np.bool_)


def _rooms(found: RoomSurvey) -> dict[str, Any]:
    r = found.regions
    return {
        "cells": _array(r.grid.cells), "origin_xy_m": list(map(float, r.grid.origin_xy_m)),
        "resolution_m": r.grid.resolution_m, "wall": _array(r.wall), "label": _array(r.label),
        "n": int(r.n), "border": _array(r.border),
        "ids": _array(found.ids), "next_id": found.next_id, "lost": [list(x) for x in found.lost],
    }  # fmt: skip


def rooms_of(said: dict[str, Any]) -> RoomSurvey:
    """Decode a survey of the rooms; in older recordings the rooms have no ids."""
    origin = said["origin_xy_m"]
    grid = Grid(_array_of(said["cells"]), (origin[0], origin[1]), said["resolution_m"])
    wall, label = _array_of(said["wall"]), _array_of(said["label"])
    regions = RegionMap(grid, wall, label, said["n"], _array_of(said["border"]))
    ids = _array_of(said["ids"]) if "ids" in said else np.zeros(said["n"] + 1, np.int64)
    lost = tuple(LostRoom(int(i), float(x), float(y)) for i, x, y in said.get("lost", ()))
    return outline_rooms(regions, ids, said.get("next_id", 1), lost)


def _similarity(found: tuple[Any, ImageSimilarity]) -> dict[str, Any]:
    said = found[1]
    return {
        "stamp_ns": said.stamp_ns, "pose": _pose(said.pose), "targets": list(said.targets),
        "score": _array(said.score),
    }  # fmt: skip


def similarity_of(said: dict[str, Any]) -> ImageSimilarity:
    """Decode the answer of a similarity scorer."""
    targets, score = tuple(said["targets"]), _array_of(said["score"])
    return ImageSimilarity(said["stamp_ns"], SE2(*said["pose"]), targets, score)


def _choice(found: tuple[Any, FrontierChoice]) -> dict[str, Any]:
    said = found[1]
    return {
        "stamp_ns": said.stamp_ns, "target": said.target, "ids": [int(i) for i in said.ids],
        "p": _array(said.p), "elsewhere": float(said.elsewhere), "scene": float(said.scene),
    }  # fmt: skip


def choice_of(said: dict[str, Any]) -> FrontierChoice:
    """Decode the answer of a choice scorer."""
    return FrontierChoice(
        said["stamp_ns"], said["target"], tuple(said["ids"]), _array_of(said["p"]),
        said["elsewhere"], said["scene"],
    )  # fmt: skip


def _refined(r: RefinedTrajectory) -> dict[str, Any]:
    return {
        "poses": _array(r.poses), "speeds_mps": _array(r.speeds_mps), "times_s": _array(r.times_s),
        "leg": _array(r.leg),
        "legs": [{"points_m": _array(x.points_m), "ends_segment": x.ends_segment} for x in r.legs],
        "drivable": sorted(r.drivable),
        "heading_rad": None if r.heading_rad is None else float(r.heading_rad),
        "cost_m": float(r.cost_m),
        "control_m": float(r.control_m), "off_region_m": float(r.off_region_m),
        "notes": list(r.notes),
    }  # fmt: skip


def _refined_of(said: dict[str, Any]) -> RefinedTrajectory:
    arrays = {name: _array_of(said[name]) for name in ("poses", "speeds_mps", "times_s", "leg")}
    legs = tuple(Leg(_array_of(leg["points_m"]), leg["ends_segment"]) for leg in said["legs"])
    numbers = {name: said[name] for name in ("heading_rad", "cost_m", "control_m", "off_region_m")}
    drivable, notes = frozenset(said["drivable"]), tuple(said["notes"])
    return RefinedTrajectory(**arrays, legs=legs, drivable=drivable, **numbers, notes=notes)


def _draft(d: PlanResult) -> dict[str, Any]:
    return {
        "refined": None if d.refined is None else _refined(d.refined), "error": d.error,
        "hopeless": d.hopeless, "mistakable": d.ambiguous, "speed_mps": d.speed_mps,
        "coarse_m": None if d.coarse_m is None else _array(d.coarse_m),
        "stops_at": d.stops_at, "stops": d.stops, "upto": d.n_done,
        "understood": d.understood, "prompt": d.prompt,
        "rounds": [asdict(r) for r in d.rounds],
    }  # fmt: skip


def draft_of(said: dict[str, Any]) -> PlanResult:
    """Decode a `PlanResult`; older recordings have no `mistakable`, or no `stops`."""
    refined, coarse_m, stops_at = said["refined"], said["coarse_m"], said["stops_at"]
    same = {name: said[name] for name in ("error", "hopeless", "understood", "prompt")}
    return PlanResult(
        refined=None if refined is None else _refined_of(refined),
        ambiguous=tuple(said.get("mistakable", ())),
        coarse_m=None if coarse_m is None else _array_of(coarse_m),
        speed_mps=said["speed_mps"],
        stops_at=None if stops_at is None else (stops_at[0], stops_at[1]),
        stops=tuple(
            tuple((number, label) for number, label in step)
            for step in said.get("stops", () if stops_at is None else ((stops_at,),))
        ),
        rounds=tuple(PlanAttempt(**r) for r in said["rounds"]),
        n_done=said["upto"],
        **same,
    )


def _survey(distance_m: np.ndarray) -> dict[str, Any]:
    return {"distance_m": _array(distance_m)}


def survey_of(said: dict[str, Any]) -> np.ndarray:
    """Decode the driving distances of a survey, in metres."""
    return _array_of(said["distance_m"])


_RESULT: dict[str, Callable[[Any], dict[str, Any]]] = {
    "detector": _boxes, "travel_cost": _survey, "rooms": _rooms, "similarity": _similarity,
    "choice": _choice, "task": _draft,
}  # fmt: skip


def _answer_of(said: dict[str, Any]) -> dict[str, Any]:
    blocked = said.pop("blocked")
    return {"goal_status": GoalStatus(**said, blocked=None if blocked is None else tuple(blocked))}


def config_text(config: Config) -> dict[str, Any]:
    """Return a configuration as JSON without secrets."""
    return redact(config.model_dump(mode="json"))


def config_of(said: dict[str, Any]) -> Config:
    """Decode a configuration; raise ConfigError."""
    path = said.pop("path", "<recording>")
    return parse(said, path)


_UNCHANGED = dict
_ENCODE: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "start": _start,
    "tick": _UNCHANGED,
    "images": lambda fields: {"done": fields["done"]},
    "request": _UNCHANGED,
    "result": lambda fields: {
        "worker": fields["worker"], "result": _RESULT[fields["worker"]](fields["result"])
    },
    "decision": _UNCHANGED,
    "idle": lambda fields: {"now_ns": fields["now_ns"], "pose": _pose(fields["pose"])},
    "goal_status": lambda fields: asdict(fields["goal_status"]),
    "mission": lambda fields: {
        **fields, "translation": _translation(fields["translation"])
    },
    "pause": _UNCHANGED,
    "cancel": _UNCHANGED,
    "fail": _UNCHANGED,
    "config": lambda fields: {"config": config_text(fields["config"])},
    "jump": _UNCHANGED,
    "site": lambda fields: {**fields, "site": fields["site"].geojson()},
}  # fmt: skip
_DECODE: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    **dict.fromkeys(_ENCODE, _UNCHANGED),
    "start": _start_of,
    "goal_status": _answer_of,
    "mission": lambda said: {**said, "translation": _translation_of(said["translation"])},
    "config": lambda said: {"config": config_of(said["config"])},
    "site": lambda said: {**said, "site": site_of(said["site"])},
    "idle": lambda said: {
        "now_ns": said["now_ns"], "pose": None if said["pose"] is None else SE2(*said["pose"])
    },
}  # fmt: skip
