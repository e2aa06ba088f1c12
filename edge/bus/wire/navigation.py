"""Codec of Nav2's messages: NavigateToPose, DockRobot, UndockRobot and CostmapFilterInfo.

An action is three services and two topics: `send_goal`, `get_result` and `cancel_goal` are
services, `feedback` and `status` are topics, all below `<action>/_action/`. The client chooses a
random 16-byte id for each goal.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from edge.bus.wire.cdr import STAMP, U8, U32, CdrReader, CdrWriter, DecodeError
from edge.bus.wire.messages import MAP_FRAME, read_pose, write_pose
from edge.geometry import SE2

_UUID = struct.Struct("<16s")
_I8 = struct.Struct("<b")
_I16 = struct.Struct("<h")
_U16 = struct.Struct("<H")
_F32 = struct.Struct("<f")
_MAX_GOALS = 1024
_KEEPOUT_FILTER = 0
_MAX_STAGING_S, _MAX_UNDOCKING_S = 1000.0, 30.0  # the defaults of DockRobot, UndockRobot

# Statuses of action_msgs/GoalStatus.
ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 1, 2, 3, 4, 5, 6
SETTLED = (SUCCEEDED, CANCELED, ABORTED)
"""Statuses of a goal that has ended."""
ALL_GOALS = bytes(16)
"""Goal id that cancels all goals of an action (action_msgs/CancelGoal)."""


def encode_send_goal(goal_id: bytes, stamp_ns: int, pose: SE2, frame_id: str = MAP_FRAME) -> bytes:
    """Encode NavigateToPose_SendGoal_Request, with Nav2's default behavior tree."""
    writer = CdrWriter().write(_UUID, 1, goal_id).header(stamp_ns, frame_id)
    return write_pose(writer, pose.matrix()).string("").bytes()


def encode_dock_goal(
    goal_id: bytes, stamp_ns: int, dock_id: str, frame_id: str = MAP_FRAME
) -> bytes:
    """Encode DockRobot_SendGoal_Request for a dock that the docking server knows by its id.

    The server drives to the staging pose of the dock itself.
    """
    # use_dock_id, dock_id; so the server ignores the pose
    writer = CdrWriter().write(_UUID, 1, goal_id).write(U8, 1, 1).string(dock_id)
    write_pose(writer.header(stamp_ns, frame_id), SE2(0.0, 0.0, 0.0).matrix())
    # dock_type, max_staging_time, navigate_to_staging_pose
    return writer.string("").write(_F32, 4, _MAX_STAGING_S).write(U8, 1, 1).bytes()


def encode_undock_goal(goal_id: bytes) -> bytes:
    """Encode UndockRobot_SendGoal_Request, for the type of dock that the server docked at."""
    return CdrWriter().write(_UUID, 1, goal_id).string("").write(_F32, 4, _MAX_UNDOCKING_S).bytes()


def decode_send_goal_answer(payload: bytes) -> bool:
    """Return True if the goal was accepted."""
    (accepted,) = CdrReader(payload).read(U8, 1)
    return bool(accepted)


def encode_get_result(goal_id: bytes) -> bytes:
    """Encode NavigateToPose_GetResult_Request."""
    return CdrWriter().write(_UUID, 1, goal_id).bytes()


@dataclass(frozen=True, slots=True)
class Result:
    """The end of a goal.

    Attributes:
        status: one of `SETTLED`, or another status of action_msgs/GoalStatus.
        error_code: Nav2's error code; 0: none.
        error: Nav2's error message; "": none.
    """

    status: int
    error_code: int = 0
    error: str = ""


def decode_result(payload: bytes, has_success: bool = False, has_retries: bool = False) -> Result:
    """Decode the GetResult_Response of an action, of any distribution.

    Humble's result of NavigateToPose is empty. Later distributions have an error code, the newest
    also a message. The length shows which fields there are.

    Args:
        payload: the message.
        has_success: the result has a field `success` (DockRobot, UndockRobot).
        has_retries: the result has a number of retries (DockRobot).
    """
    reader = CdrReader(payload)
    (status,) = reader.read(_I8, 1)
    if has_success:  # the status has it as well
        reader.skip(U8.size, 1)
    elif reader.left < 3:
        return Result(status)
    (code,) = reader.read(_U16, 2)
    if has_retries:
        reader.skip(_U16.size, 2)
    return Result(status, code, reader.string() if reader.left >= 4 else "")


def encode_cancel(goal_id: bytes) -> bytes:
    """Encode action_msgs/CancelGoal_Request of one goal."""
    return CdrWriter().write(_UUID, 1, goal_id).write(STAMP, 4, 0, 0).bytes()


def decode_goal_statuses(payload: bytes) -> list[tuple[bytes, int]]:
    """Decode action_msgs/GoalStatusArray as (goal_id, status) of each goal."""
    reader = CdrReader(payload)
    (count,) = reader.read(U32, 4)
    if count > _MAX_GOALS:
        raise DecodeError(f"message of {count} goals, at most {_MAX_GOALS} are allowed")
    goals = []
    for _ in range(count):
        (goal_id,) = reader.read(_UUID, 1)
        reader.skip(STAMP.size, 4)
        goals.append((goal_id, reader.read(_I8, 1)[0]))
    return goals


def encode_keepout_info(stamp_ns: int, frame_id: str, mask_topic: str) -> bytes:
    """Encode the nav2_msgs/CostmapFilterInfo with the topic of the mask for a KeepoutFilter."""
    writer = CdrWriter().header(stamp_ns, frame_id).write(U8, 1, _KEEPOUT_FILTER)
    # base and multiplier: the cost is that of the mask
    return writer.string(mask_topic).floats((0.0, 1.0), "f").bytes()


@dataclass(frozen=True, slots=True)
class Feedback:
    """NavigateToPose_FeedbackMessage: progress of a goal.

    Attributes:
        recoveries: number of recoveries so far.
        distance_m: distance that is left to drive.
    """

    goal_id: bytes
    recoveries: int
    distance_m: float


def decode_feedback(payload: bytes) -> Feedback:
    """Decode NavigateToPose_FeedbackMessage without fields that later distributions append."""
    reader = CdrReader(payload)
    (goal_id,) = reader.read(_UUID, 1)
    reader.header()
    read_pose(reader)
    reader.skip(2 * STAMP.size, 4)  # the time since the start, and the estimated time left
    (recoveries,) = reader.read(_I16, 2)
    (distance_m,) = reader.read(_F32, 4)
    return Feedback(goal_id, recoveries, distance_m)
