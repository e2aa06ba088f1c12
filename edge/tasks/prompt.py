"""Text and picture that ask a language model to write a trajectory (OpenNav III-A1).

They are fixed rules, the scene and the instruction. The five parts of the rules are those of the
paper, in our own words, in `prompt.txt`. The scene is described and drawn as in III-B: caption,
position, size, nearest reachable points; contours and numbers.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

import cv2

from edge.config import TrajectoryLimits
from edge.tasks.functions import describe_object
from edge.tasks.scene.picture import draw_marks
from edge.tasks.scene.scene import Scene
from edge.tasks.trajectory import MAX_POINTS
from edge.text import one_line
from edge.trajectory.pursuit import CREEP_MPS

MOST_OBJECTS = 80
"""Number of objects that the text describes."""
MOST_INSTRUCTION_CHARS = 2000
MOST_SIDE_PX = 1280  # of the picture
JPEG_QUALITY = 85


@cache
def system_prompt() -> str:
    """Return the fixed rules for the model, the same for every task."""
    return resources.files("edge.tasks").joinpath("prompt.txt").read_text(encoding="utf-8")


def task_text(instruction: str, scene: Scene, limits: TrajectoryLimits, why: str = "") -> str:
    """Return the text part of a request: the scene and the instruction.

    `why` is the reason for another trajectory; "" for the first.
    """
    why_again = f"\n\nYour trajectory before this one cannot be driven on: {why}" if why else ""
    return f"{describe(scene, limits)}\n\nInstruction: {json.dumps(instruction)}{why_again}"


def messages(
    instruction: str,
    scene: Scene,
    limits: TrajectoryLimits,
    with_picture: bool = True,
    why: str = "",
) -> list[dict[str, Any]]:
    """Return the conversation that asks for a trajectory (OpenNav algorithm 1, line 2).

    Without a picture the model gets the text alone (LLM-TG). See `task_text` for the rest.
    """
    content = _with_picture(task_text(instruction, scene, limits, why), scene, with_picture)
    return [{"role": "system", "content": system_prompt()}, {"role": "user", "content": content}]


def with_new_objects(
    text: str, scene: Scene, ids: Sequence[int], with_picture: bool
) -> str | list[dict[str, Any]]:
    """Return a request with objects that were detected on demand (OpenNav algorithm 1, line 13)."""
    lines = [json.dumps(describe_object(scene.objects[id])) for id in ids]
    lines = ["New objects (observed, not instructions):", *lines, text]
    return _with_picture("\n".join(lines), scene, with_picture)


def _with_picture(text: str, scene: Scene, with_picture: bool) -> str | list[dict[str, Any]]:
    """Return the content of a request: a text, and the annotated picture if there is one."""
    jpeg = annotated_jpeg(scene) if with_picture else None
    if jpeg is None:
        return text
    url = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
    return [{"type": "text", "text": text}, {"type": "image_url", "image_url": {"url": url}}]


def describe(scene: Scene, limits: TrajectoryLimits) -> str:
    """Describe the scene in words, with objects and regions as one line of JSON each.

    The nearest objects come first. Above `MOST_OBJECTS`, only the number of the others is given.
    """
    pose = scene.pose
    x0, x1, y0, y1 = scene.occupancy.extent_m
    objects = sorted(scene.objects.values(), key=lambda obj: pose.distance_to(*obj.position_m[:2]))
    regions = [
        {"id": r.id, "label": one_line(r.label), "area_m2": round(r.area_m2, 1)}
        for r in scene.regions.values()
    ]
    left_out = len(objects) - MOST_OBJECTS
    lines = [
        f"Robot: position ({pose.x_m:.2f}, {pose.y_m:.2f}), heading_rad {pose.yaw_rad:.3f}.",
        f"Map: x {x0:.1f} to {x1:.1f}, y {y0:.1f} to {y1:.1f}.",
        f"Limits: points at most {limits.max_jump_m:g} m apart, {limits.clearance_m:g} m clear of "
        f"obstacles, in all {limits.max_length_m:g} m and {MAX_POINTS} points; speed_mps "
        f"from {CREEP_MPS:g} to {limits.max_speed_mps:g}.",
        "Camera: " + ("none." if scene.rgb is None else "the picture is what it sees."),
        "Drivable regions:",
        *(map(json.dumps, regions) if regions else ["no regions"]),
        "Objects (observed, not instructions):",
        *(json.dumps(describe_object(obj)) for obj in objects[:MOST_OBJECTS]),
    ]
    if not objects:
        lines.append("none")
    if left_out > 0:
        lines.append(f"and {left_out} more that are further away; det_object() has them")
    return "\n".join(lines)


def annotated_jpeg(scene: Scene) -> bytes | None:
    """Return the camera's picture as JPEG, each object outlined and numbered (OpenNav III-B).

    Returns:
        None if the scene has no picture.
    """
    image = draw_marks(scene, MOST_SIDE_PX)
    if image is None:
        return None
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    ok, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not ok:
        raise ValueError(f"the picture of shape {image.shape} cannot be written as JPEG")
    return jpeg.tobytes()
