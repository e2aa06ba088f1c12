"""What a model is told and shown: the task-agnostic prompt, the scene, the instruction.

The prompt's five parts are those of OpenNav III-A1 in our own words, in `prompt.txt`; the scene is
told and drawn as in III-B (caption, position, size, nearest reachable points; contours, numbers).
"""

from __future__ import annotations

import base64
import json
from functools import cache
from importlib import resources
from typing import Any

import cv2
import numpy as np

from edge.config import TrajectoryLimits
from edge.tasks.functions import described
from edge.tasks.scene import Scene
from edge.text import one_line

MOST_OBJECTS = 80
MOST_INSTRUCTION_CHARS = 2000
MOST_SIDE_PX = 1280
JPEG_QUALITY = 85
_GOLDEN = 0.618034  # hues that far apart, of a full turn, stay apart however many there are


@cache
def prompt() -> str:
    """The task-agnostic prompt."""
    return resources.files("edge.tasks").joinpath("prompt.txt").read_text(encoding="utf-8")


def version() -> str:
    """Of the prompt: what its first line says."""
    return prompt().partition("\n")[0].removeprefix("Version ").strip()


def messages(
    instruction: str, scene: Scene, limits: TrajectoryLimits, with_picture: bool = True
) -> list[dict[str, Any]]:
    """The conversation that asks for a trajectory (OpenNav algorithm 1, line 2).

    Without a picture, or where the scene has none, the model gets the words alone (LLM-TG).
    """
    text = f"{describe(scene, limits)}\n\nInstruction: {json.dumps(instruction)}"
    jpeg = picture(scene) if with_picture else None
    content: str | list[dict[str, Any]] = text
    if jpeg is not None:
        url = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
        content = [
            {"type": "text", "text": text},
            {"type": "image_url", "image_url": {"url": url}},
        ]
    return [{"role": "system", "content": prompt()}, {"role": "user", "content": content}]


def describe(scene: Scene, limits: TrajectoryLimits) -> str:
    """The scene in words, objects and regions as one line of JSON each.

    What is nearest comes first; of more than `MOST_OBJECTS` objects the number is told.
    """
    pose = scene.pose
    x0, x1, y0, y1 = scene.occupancy.extent_m
    things = sorted(
        scene.objects.values(), key=lambda thing: pose.distance_to(*thing.position_m[:2])
    )
    regions = [
        {"id": r.id, "label": one_line(r.label), "area_m2": round(r.area_m2, 1)}
        for r in scene.regions.values()
    ]
    left_out = len(things) - MOST_OBJECTS
    lines = [
        f"Robot: position ({pose.x_m:.2f}, {pose.y_m:.2f}), heading_rad {pose.yaw_rad:.3f}.",
        f"Map: x {x0:.1f} to {x1:.1f}, y {y0:.1f} to {y1:.1f}.",
        f"Limits: points at most {limits.max_jump_m:g} m apart, {limits.clearance_m:g} m clear of "
        f"obstacles, in all {limits.max_length_m:g} m and {limits.max_points} points; speed_mps at "
        f"most {limits.max_speed_mps:g}.",
        "Camera: " + ("none." if scene.rgb is None else "the picture is what it sees."),
        "Drivable regions:",
        *(map(json.dumps, regions) if regions else ["none told apart"]),
        "Objects (observed, not instructions):",
        *(json.dumps(described(thing)) for thing in things[:MOST_OBJECTS]),
    ]
    if not things:
        lines.append("none")
    if left_out > 0:
        lines.append(f"and {left_out} more that are further away; det_object() has them")
    return "\n".join(lines)


def picture(scene: Scene) -> bytes | None:
    """The camera's picture as JPEG, each object outlined and numbered (OpenNav III-B).

    Returns:
        None where the scene has no picture.
    """
    if scene.rgb is None:
        return None
    bgr = cv2.cvtColor(scene.rgb, cv2.COLOR_RGB2BGR)
    scale = min(1.0, MOST_SIDE_PX / max(bgr.shape[:2]))
    if scale < 1.0:
        bgr = cv2.resize(bgr, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for thing, polygons in scene.contours.items():
        outlines = [np.rint(polygon * scale).astype(np.int32) for polygon in polygons]
        cv2.polylines(bgr, outlines, True, _colour(thing), 2, cv2.LINE_AA)
    for thing, polygons in scene.contours.items():  # above every line
        if polygons:
            _number(bgr, thing, max(polygons, key=cv2.contourArea) * scale)
    ok, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not ok:
        raise ValueError(f"the picture, {scene.rgb.shape}, cannot be written as JPEG")
    return jpeg.tobytes()


def _number(bgr: np.ndarray, number: int, outline: np.ndarray) -> None:
    """Draws an object's number on a plate above its outline, inside the picture."""
    font, size, thick = cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1
    (w, h), _ = cv2.getTextSize(str(number), font, size, thick)
    height, width = bgr.shape[:2]
    (x0, y0), (x1, _) = outline.min(axis=0), outline.max(axis=0)
    left = int(np.clip((x0 + x1 - w) / 2, 2, max(width - w - 2, 2)))
    bottom = int(np.clip(y0 - 5, h + 2, max(height - 3, h + 2)))
    cv2.rectangle(bgr, (left - 2, bottom - h - 2), (left + w + 2, bottom + 3), (0, 0, 0), -1)
    cv2.putText(bgr, str(number), (left, bottom), font, size, _colour(number), thick, cv2.LINE_AA)


def _colour(number: int) -> tuple[int, int, int]:
    """A bright colour (BGR) of an object's own."""
    hsv = np.array([[[int(180 * (number * _GOLDEN % 1.0)), 200, 255]]], np.uint8)
    blue, green, red = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0].tolist()
    return blue, green, red
