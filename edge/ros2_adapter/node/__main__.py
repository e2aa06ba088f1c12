"""`python3 node`: runs the adapter's node by a plan, until standard input is closed.

The plan is one line of JSON on standard input; see `make_plan` of `edge.ros2_adapter.process`. One
thread does everything, between callbacks of ROS; messages from Zenoh wake it.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import threading
import time
from importlib import import_module
from typing import Any

from action import NavigateProxy
from passing import AdapterEnds, FromRos, SetupError, ToRos, find_type, one_line

log = logging.getLogger("edge.ros2_adapter")

GRAPH_S = 0.2  # period of checks for receivers and servers
SETTLE_S = 0.5  # time for cancelling the goal at the end
_OPEN_AGAIN_S = 0.5  # time between two attempts to connect to the service
_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)  # they end the node


def main() -> int:
    """Run until standard input closes or a signal comes; return an exit code of sysexits.h."""
    logging.basicConfig(level=logging.INFO, format="ros2-adapter: %(message)s", stream=sys.stderr)
    stop = threading.Event()
    # A thread waits for the signals: a handler must not take the event's lock, since the main
    # thread may hold it. Threads that begin later inherit the mask.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    threading.Thread(target=_watch_signals, args=(stop,), daemon=True).start()
    plan = json.loads(sys.stdin.readline())
    threading.Thread(target=_watch_input, args=(stop,), daemon=True).start()
    try:
        run(plan, stop)
    except SetupError as error:
        log.error("%s", error)
        return os.EX_UNAVAILABLE
    return os.EX_OK


def _watch_signals(stop: threading.Event) -> None:
    signal.sigwait(_SIGNALS)
    stop.set()


def _watch_input(stop: threading.Event) -> None:
    """Set `stop` when the input closes, because its other end is the process that started this one.

    Read without Python's buffer, because a thread must not hold the buffer's lock when the
    interpreter ends.
    """
    while os.read(0, 4096):
        pass
    stop.set()


def run(plan: dict[str, Any], stop: threading.Event) -> None:
    """Pass messages until `stop` is set.

    Raises:
        SetupError: a package, a message type or a Zenoh setting is missing.
    """
    rclpy, zenoh = _import_or_explain("rclpy", plan), _import_or_explain("zenoh", plan)
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    session = _open(zenoh, plan, stop)
    if session is None:
        return
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node(plan["node"], start_parameter_services=False)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        ends = AdapterEnds(node, session, zenoh, node.create_guard_condition(lambda: None).trigger)
        received = [FromRos(ends, topic, find_type(topic["type"])) for topic in plan["heard"]]
        # Functions that are called in every turn (`often`), or every `GRAPH_S` (`rarely`).
        often = [ToRos(ends, topic, plan["max_bytes"]).update for topic in plan["said"]]
        rarely, action, due_s = [topic.update for topic in received], None, 0.0
        if plan["action"] is not None:
            action = NavigateProxy(ends, plan["action"], lambda: any(t.wanted for t in received))
            often.append(action.pass_requests)
            rarely.append(action.update)
        log.info("passing up to %d topics from ROS 2 to edge, and %d from edge to ROS 2",
                 len({topic["ros"] for topic in plan["heard"]}), len(plan["said"]))  # fmt: skip
        while not stop.is_set():
            executor.spin_once(timeout_sec=GRAPH_S)
            for update in often:
                update()
            if time.monotonic() >= due_s:
                due_s = time.monotonic() + GRAPH_S
                for update in rarely:
                    update()
        if action is not None and action.cancel():
            until_s = time.monotonic() + SETTLE_S
            while time.monotonic() < until_s:
                executor.spin_once(timeout_sec=GRAPH_S)
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
        session.close()


def _import_or_explain(name: str, plan: dict[str, Any]) -> Any:
    """Return a module; raise SetupError that says how to install it."""
    try:
        return import_module(name)
    except ImportError as error:
        what = {
            "rclpy": "source ROS 2's setup file first, or name it in ros2.adapter.setup",
            "zenoh": f"{sys.executable} -m pip install eclipse-zenoh=={plan['version']}",
        }[name]
        raise SetupError(f"{sys.executable}: cannot import {name} ({error}): {what}") from None


def _open(zenoh: Any, plan: dict[str, Any], stop: threading.Event) -> Any:
    """Open a session when the service is there; return None once `stop` is set."""
    try:
        config = zenoh.Config.from_json5(plan["zenoh"])
    except zenoh.ZError as error:
        versions = f"written by eclipse-zenoh {plan['version']}"
        raise SetupError(
            f"zenoh: cannot read the settings ({versions}); install the same version here: {error}"
        ) from None
    logged = False
    while not stop.is_set():
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if not logged:
                logged = True
                log.info("waiting for edge: %s", one_line(str(error).split(" at /")[0]))
            stop.wait(_OPEN_AGAIN_S)
    return None


if __name__ == "__main__":
    sys.exit(main())
