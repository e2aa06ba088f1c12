"""A Nav2 of our own making: NavigateToPose and DockRobot over Zenoh, its messages by `rosbags`.

Stands in for what the package index does not have. It does what a test tells it to.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import zenoh
from ros_messages import (
    DOCK_FAREWELLS,
    FAREWELLS,
    STORE,
    UNDOCK_FAREWELLS,
    from_ros,
    header,
    pose,
    to_ros,
)

from edge.bus.ros2 import names
from edge.bus.ros2.names import RMW_ZENOH, Dialect, Endpoint
from edge.geometry import SE2

ACTION = "/navigate_to_pose/_action"
_ACTIONS = {
    "NavigateToPose": ("navigate_to_pose", FAREWELLS, 500),
    "DockRobot": ("dock_robot", DOCK_FAREWELLS, 510),
    "UndockRobot": ("undock_robot", UNDOCK_FAREWELLS, 520),
}
"""Name, results by distribution, and number of its node."""
_FEEDBACK = "nav2_msgs/action/NavigateToPose_FeedbackMessage"
_STATUS = "action_msgs/msg/GoalStatusArray"


class Nav2:
    """The server.

    Attributes:
        goals: (id, request) in the order of coming.
        cancelled: ids.
        junk: how many of the next answers to new goals are none.
    """

    def __init__(
        self,
        session: zenoh.Session,
        distribution: str = "kilted",
        accepts: bool = True,
        dialect: Dialect = RMW_ZENOH,
        action: str = "NavigateToPose",
    ) -> None:
        name, farewells, first = _ACTIONS[action]
        self._action = action
        below = f"/{name}/_action"
        types = {
            "send_goal": f"nav2_msgs/action/{action}_SendGoal",
            "get_result": f"nav2_msgs/action/{action}_GetResult",
            "cancel_goal": "action_msgs/srv/CancelGoal",
        }
        self._dialect = dialect
        self.goals: list[tuple[bytes, Any]] = []
        self.cancelled: list[bytes] = []
        self.accepts = accepts
        self.junk = 0
        self._session = session
        self._farewell = farewells[distribution][0]
        self._hash = names.NO_HASH if distribution == "humble" else "RIHS01_" + "ab" * 32
        self._waiting: dict[bytes, zenoh.Query] = {}
        self._lock = threading.Lock()
        self._open: list[Any] = []
        zid = str(session.info.zid())
        for i, (service, type_name) in enumerate(types.items()):
            handle = getattr(self, f"_{service}")
            key = dialect.data_key(0, f"{below}/{service}", type_name, self._hash)
            self._open.append(session.declare_queryable(key, handle, complete=True))
            if not dialect.has_tokens:
                continue
            said = Endpoint("SS", zid, "bt_navigator", f"{below}/{service}", type_name, self._hash)
            token = names.endpoint_token(0, first, first + 1 + i, said, names.RELIABLE)
            self._open.append(session.liveliness().declare_token(token))

    def _reply(self, query: zenoh.Query, payload: bytes) -> None:
        attached = b"" if query.attachment is None else query.attachment.to_bytes()
        # rmw_zenoh's servers refuse a request without; a bridge takes it for something else.
        assert len(attached) == (33 if self._dialect.has_tokens else 0)
        query.reply(query.key_expr, payload, attachment=query.attachment)

    def _send_goal(self, query: zenoh.Query) -> None:
        name = "nav2_msgs/msg/NavigateToPose_SendGoal_"
        kind = f"nav2_msgs/msg/{self._action}_SendGoal_Request"
        request = from_ros(query.payload.to_bytes(), kind)
        with self._lock:
            self.goals.append((bytes(request.goal_id.uuid), request.goal))
            self.junk, is_junk = max(self.junk - 1, 0), self.junk > 0
        if is_junk:
            self._reply(query, b"junk")
            return
        time = STORE.types["builtin_interfaces/msg/Time"](1, 2)
        self._reply(query, to_ros(STORE.types[f"{name}Response"](self.accepts, time)))

    def _get_result(self, query: zenoh.Query) -> None:
        name = "nav2_msgs/msg/NavigateToPose_GetResult_Request"
        request = from_ros(query.payload.to_bytes(), name)
        with self._lock:
            self._waiting[bytes(request.goal_id.uuid)] = query

    def _cancel_goal(self, query: zenoh.Query) -> None:
        request = from_ros(query.payload.to_bytes(), "action_msgs/msg/CancelGoal_Request")
        self.cancelled.append(bytes(request.goal_info.goal_id.uuid))
        self._reply(query, to_ros(STORE.types["action_msgs/msg/CancelGoal_Response"](0, [])))

    def asked(self, goal_id: bytes) -> bool:
        """Return True if a client waits for this goal's result."""
        return goal_id in self._waiting

    def end(self, goal_id: bytes, status: int, code: int = 0, text: str = "") -> None:
        """Send the goal's result to its waiting client."""
        with self._lock:
            query = self._waiting.pop(goal_id)
        self._reply(query, self._farewell(status, code, text))

    def lose(self, goal_id: bytes) -> None:
        """End the query without the awaited result."""
        with self._lock:
            self._waiting.pop(goal_id).drop()

    def feed_back(self, goal_id: bytes, recoveries: int, distance_m: float) -> None:
        types = STORE.types
        duration = types["builtin_interfaces/msg/Duration"](1, 0)
        where = types["geometry_msgs/msg/PoseStamped"](header(5, "map"), pose(SE2(0.0, 0.0, 0.0)))
        inner = types["nav2_msgs/msg/NavigateToPose_Feedback"](
            where, duration, duration, recoveries, distance_m
        )
        message = types["nav2_msgs/msg/NavigateToPose_FeedbackMessage"](ros_id(goal_id), inner)
        self._put("feedback", _FEEDBACK, to_ros(message))

    def say_status(self, goal_id: bytes, status: int) -> None:
        types = STORE.types
        info = types["action_msgs/msg/GoalInfo"](
            ros_id(goal_id), types["builtin_interfaces/msg/Time"](1, 2)
        )
        goal = types["action_msgs/msg/GoalStatus"](info, status)
        self._put("status", _STATUS, to_ros(types[_STATUS]([goal])))

    def _put(self, topic: str, type_name: str, payload: bytes) -> None:
        key = self._dialect.data_key(0, f"{ACTION}/{topic}", type_name, self._hash)
        self._session.put(key, payload)

    def close(self) -> None:
        for one in self._open:
            one.undeclare()


def ros_id(goal_id: bytes) -> Any:
    return STORE.types["unique_identifier_msgs/msg/UUID"](np.frombuffer(goal_id, np.uint8))
