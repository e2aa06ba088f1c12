"""Passes the action NavigateToPose: three services and two topics."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from passing import AdapterEnds, FromRos, Inbox, cdr_of, find_type, one_line

log = logging.getLogger("edge.ros2_adapter")

GONE_S = 3.0  # after this time without a receiver on Zenoh, no service supervises the robot
_REQUEST_BYTES = 4096
_QUEUE_SIZE = 16  # requests that wait for the node's thread


class ServiceProxy:
    """A ROS service, offered on Zenoh while it has a server.

    Args:
        ends: node and session.
        names: the service's name in ROS (`ros`) and its key in Zenoh (`key`).
        kind: the class of the service's type.
        on_answer: called with each request and its answer.
    """

    def __init__(
        self,
        ends: AdapterEnds,
        names: dict[str, str],
        kind: Any,
        on_answer: Callable[[Any, Any], None],
    ) -> None:
        self._ends, self._key, self._kind, self._on_answer = ends, names["key"], kind, on_answer
        self._client = ends.node.create_client(kind, names["ros"])
        self._inbox, self._queryable = Inbox(_QUEUE_SIZE, ends.wake), None
        self._waiting: dict[Any, Any] = {}  # future of the ROS answer: query from Zenoh
        self._warned = False

    def update(self) -> None:
        """Offer the service while it has a server; otherwise drop pending requests."""
        if self._client.service_is_ready():
            if self._queryable is None:
                self._queryable = self._ends.session.declare_queryable(
                    self._key, self._inbox, complete=True
                )
        elif self._queryable is not None:
            self._queryable.undeclare()
            self._queryable = None
            for future, query in self._waiting.items():
                self._client.remove_pending_request(future)
                query.drop()
            self._waiting.clear()

    def pass_requests(self) -> None:
        """Send the requests that came from Zenoh to the server."""
        for query in self._inbox.take():
            self._forward_request(query)

    def ask(self, request: Any) -> None:
        """Send a request without waiting for its answer."""
        self._client.call_async(request)

    def _forward_request(self, query: Any) -> None:
        from rclpy.serialization import deserialize_message

        try:
            payload = cdr_of(query.payload, _REQUEST_BYTES)
            request = deserialize_message(payload, self._kind.Request)
        except Exception as error:  # errors depend on the ROS middleware
            if not self._warned:
                self._warned = True
                text = "%s: a request was dropped: %s (further ones are not logged)"
                log.warning(text, self._key, one_line(error))
            query.drop()
            return
        future = self._client.call_async(request)
        self._waiting[future] = query
        future.add_done_callback(lambda done: self._answer(request, done))

    def _answer(self, request: Any, done: Any) -> None:
        from rclpy.serialization import serialize_message

        query = self._waiting.pop(done, None)
        if query is not None and not done.cancelled():
            query.reply(query.key_expr, serialize_message(done.result()))
            query.drop()
            self._on_answer(request, done.result())


class NavigateProxy:
    """Passes NavigateToPose: three services and two topics.

    The goal that was accepted last is cancelled if the service is gone.
    """

    def __init__(
        self, ends: AdapterEnds, plan: dict[str, str], is_followed: Callable[[], bool]
    ) -> None:
        impl = find_type(plan["type"]).Impl  # message and service types of the action's parts

        def names(part: str) -> dict[str, Any]:
            """Return ROS name and Zenoh key of a part: `/navigate_to_pose/_action/status`."""
            return {field: f"{plan[field]}/_action/{part}" for field in ("ros", "key")}

        def service(name: str, kind: Any, on_answer: Callable[[Any, Any], None]) -> ServiceProxy:
            return ServiceProxy(ends, names(name), kind, on_answer)

        def topic(name: str, kind: Any) -> FromRos:
            quality = {"reliable": True, "latched": False, "on_events": True, "depth": 10}
            return FromRos(ends, {**names(name), **quality}, kind)

        self._cancel_goal = impl.CancelGoalService
        self._send = service("send_goal", impl.SendGoalService, self._on_accepted)
        self._result = service("get_result", impl.GetResultService, self._on_result)
        self._cancel = service("cancel_goal", impl.CancelGoalService, lambda *_: None)
        self._services = self._send, self._result, self._cancel
        self._topics = [
            topic("feedback", impl.FeedbackMessage), topic("status", impl.GoalStatusMessage)
        ]  # fmt: skip
        self._is_followed = is_followed
        self._goal_id: Any = None  # the goal accepted last, until it ends
        self._followed_s = time.monotonic()  # last time that `is_followed` was True

    def pass_requests(self) -> None:
        """Send the requests that came from Zenoh to the action's server."""
        for service in self._services:
            service.pass_requests()

    def update(self) -> None:
        """Check for servers and receivers; cancel the goal if the service is gone."""
        for proxy in (*self._services, *self._topics):
            proxy.update()
        if self._is_followed():
            self._followed_s = time.monotonic()
        elif time.monotonic() - self._followed_s > GONE_S and self.cancel():
            log.warning(
                "edge is gone (no receiver for %g s): its navigation goal is cancelled", GONE_S
            )

    def cancel(self) -> bool:
        """Cancel our active goal; return True if there was one."""
        goal_id, self._goal_id = self._goal_id, None
        if goal_id is None:
            return False
        request = self._cancel_goal.Request()
        request.goal_info.goal_id = goal_id
        self._cancel.ask(request)
        return True

    def _on_accepted(self, request: Any, answer: Any) -> None:
        if answer.accepted:
            self._goal_id = request.goal_id

    def _on_result(self, request: Any, answer: Any) -> None:
        if request.goal_id == self._goal_id:
            self._goal_id = None
