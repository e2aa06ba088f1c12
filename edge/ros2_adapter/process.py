"""`edge ros2-adapter`: starts the node in ROS's Python with its plan, and again when it fails.

The node is another process because it needs another Python: the one that ROS 2 was built for, which
has none of our packages. It gets a plan, so that the configuration is read in one place only.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import shlex
import subprocess
import threading
import time
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from edge.bus import topics
from edge.bus.session import session_config
from edge.config import Config, ConfigError, load
from edge.config.ros2_adapter import Passed
from edge.errors import UnavailableError
from edge.host.signals import stop_on_signals

log = logging.getLogger("edge.ros2_adapter")

HERE = Path(__file__).parent
NODE, LAUNCH_FILE = HERE / "node.py", HERE / "edge_adapter.launch.py"
ACTION = "nav2_msgs/action/NavigateToPose"

_TYPES = {topic.key: topic.type for topic in topics.ALL if topic.type != "json"}
# A map is sent seldom and must reach whoever comes late; tf_static is said once.
_RELIABLE, _LATCHED = {"map", "goal", "tf", "tf_static"}, {"map", "tf_static"}
_GOAL_BYTES = 4096
_STOP_S = 5.0
_LOOK_S = 0.2
_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 30.0
_SOUND_S = 60.0  # a node that ran so long begins anew with the short pause


def run(args: argparse.Namespace) -> int:
    """The command; returns the exit code."""
    if args.launch_file:
        print(LAUNCH_FILE)
        return os.EX_OK
    stop = stop_on_signals()
    return supervise(load(args.config), stop)


def make_plan(config: Config) -> dict[str, Any]:
    """What the node needs to know, as JSON has it (see `edge.ros2_adapter.node`).

    Raises:
        ConfigError: nothing is to be passed, or a topic's type is not known.
    """
    adapter, limit = config.ros2_adapter, int(config.source.max_message_mb * 1e6)
    if not adapter.sensors:
        raise ConfigError(
            f"{config.path}: ros2_adapter.sensors: nothing to pass: name a ROS topic for each of "
            "ours, such as odom: /odom (config/ros2-adapter.yaml has them all)"
        )
    goals = None
    if adapter.goals is not None:
        goals = {
            "action": adapter.goals,
            "type": ACTION,
            "key": config.zenoh.key(topics.GOAL.key),
            "answer_key": config.zenoh.key(topics.GOAL_STATUS.key),
            "max_bytes": _GOAL_BYTES,
        }
    return {
        "version": version("eclipse-zenoh"),
        "zenoh": str(session_config(config.zenoh, "connect")),
        "node": adapter.node,
        "sensors": [_passed(config, "sensors", *item, limit) for item in adapter.sensors.items()],
        "results": [_passed(config, "results", *item, limit) for item in adapter.results.items()],
        "goals": goals,
    }


def _passed(config: Config, part: str, name: str, passed: Passed, max_bytes: int) -> dict[str, Any]:
    kind = passed.type or _TYPES.get(name, "").replace("/", "/msg/")
    if not kind:
        raise ConfigError(
            f"{config.path}: ros2_adapter.{part}.{name}: not a topic with a ROS type "
            f"(choices: {', '.join(_TYPES)}): give it one, as "
            "{topic: /tf, type: tf2_msgs/msg/TFMessage}"
        )
    reliable = name in _RELIABLE if passed.reliable is None else passed.reliable
    latched = name in _LATCHED if passed.latched is None else passed.latched
    return {
        "key": config.zenoh.key(name), "ros": passed.topic, "type": kind, "reliable": reliable,
        "latched": latched, "depth": passed.depth, "max_bytes": max_bytes,
    }  # fmt: skip


def command_of(config: Config) -> list[str]:
    """What starts the node.

    Raises:
        UnavailableError: a file that the configuration names is not there.
    """
    adapter = config.ros2_adapter
    for key, path in (("python", adapter.python), ("setup", adapter.setup)):
        if path is not None and not os.access(path, os.R_OK):
            raise UnavailableError(f"{config.path}: ros2_adapter.{key}: cannot read {path}")
    start = [adapter.python, "-u", str(NODE)]
    if adapter.setup is None:
        return start
    # Setup files may read their input, and end with whatever their last command did.
    script = f"source {shlex.quote(adapter.setup)} </dev/null; exec {shlex.join(start)}"
    return ["bash", "-c", script]


def supervise(config: Config, stop: threading.Event) -> int:
    """Keep the node running until `stop` is set; returns the exit code.

    Raises:
        ConfigError, UnavailableError: nothing that a restart would mend.
    """
    plan, command, pause_s = make_plan(config), command_of(config), _PAUSE_S
    while not stop.is_set():
        begun_s = time.monotonic()
        code = _run_node(command, plan, stop)
        if stop.is_set():
            break
        if code == os.EX_UNAVAILABLE:
            error = "ros2-adapter: the node cannot run here: see what it said above"
            raise UnavailableError(error)
        pause_s = _PAUSE_S if time.monotonic() - begun_s > _SOUND_S else pause_s
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        log.warning("the node ended (%s): started again in %g s", how, pause_s)
        stop.wait(pause_s)
        pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)
    return os.EX_OK


def _run_node(command: list[str], plan: dict[str, Any], stop: threading.Event) -> int:
    """Its exit code, once it has ended or `stop` is set and it was ended."""
    environ = {k: v for k, v in os.environ.items() if not k.startswith("EDGE__")}
    # A session of its own keeps the terminal's Ctrl-C for this process. Its input stays open: where
    # it closes, the node ends, so that it outlives nobody.
    node = subprocess.Popen(command, stdin=subprocess.PIPE, env=environ, start_new_session=True)
    try:
        with suppress(BrokenPipeError):
            node.stdin.write(json.dumps(plan).encode() + b"\n")
            node.stdin.flush()
        while node.poll() is None and not stop.wait(_LOOK_S):
            pass
        node.terminate()
        with suppress(subprocess.TimeoutExpired):
            node.wait(_STOP_S)
    finally:
        if node.poll() is None:
            node.kill()
        node.wait()
        with suppress(BrokenPipeError):
            node.stdin.close()
    return node.returncode
