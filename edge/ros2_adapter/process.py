"""`edge ros2-adapter`: starts the node in ROS's Python with a plan, and restarts it if it fails.

The node is a separate process because it needs the Python that ROS 2 was built for, which lacks our
packages. It gets a plan, so that only this process reads the configuration.
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

from edge.bus.ros2.names import NO_HASH, dialect_of
from edge.bus.ros2.requests import BOOL, STRING
from edge.bus.ros2.topics import LATCHED, NAVIGATE_TO_POSE, PUBLISHED, SUBSCRIBED, accepted_types
from edge.bus.session import session_config
from edge.config import Config, ConfigError, load
from edge.errors import UnavailableError
from edge.host.backoff import pause_after
from edge.host.signals import stop_on_signals

log = logging.getLogger("edge.ros2_adapter")

HERE = Path(__file__).parent
# Folder of the node's program, and the file that `--launch-file` prints.
NODE, LAUNCH_FILE = HERE / "node", HERE / "edge_adapter.launch.py"

# Messages in the queues of ROS, by topic; `_DEPTH` for all others.
_DEPTHS = {"tf": 100, "tf_static": 100, "odom": 100, "map": 1, "keepout_mask": 1, "keepout_info": 1}
_DEPTH = 5
_STOP_S = 5.0  # until a node that does not end is killed
_POLL_S = 0.2
_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 30.0  # before restarts: the first, and the limit of its doubling
_STABLE_S = 60.0  # after this run time a restart begins with the short pause again


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    if args.launch_file:
        print(LAUNCH_FILE)
        return os.EX_OK
    stop = stop_on_signals()
    return supervise(load(args.config), stop)


def make_plan(config: Config) -> dict[str, Any]:
    """Return the node's plan as JSON types.

    Returns:
        `version`: version of eclipse-zenoh here. `zenoh`: settings of the node's session. `node`:
        name of the node. `max_bytes`: largest message. `heard`, `said`: topics from ROS and to ROS.
        `action`: the action for goals, or None. A topic has its ROS name (`ros`), its Zenoh key,
        its type, `reliable`, `latched`, `depth` (its queue), and `on_events`: silence is normal.
        `stop` has several entries. The action has the first three fields.

    Raises:
        ConfigError: the service would not receive the messages.
    """
    settings = config.ros2
    if config.source.kind != "ros2":
        raise ConfigError(
            f"{config.locate('source.kind')}: {config.source.kind} does not use ROS 2: set it "
            "to ros2"
        )
    if settings.via != "adapter":
        raise ConfigError(
            f"{config.locate('ros2.via')}: {settings.via} needs no adapter: set ros2.via "
            "to adapter, or do not start the adapter"
        )
    dialect = dialect_of(settings.via, config.zenoh.prefix)

    def names_of(name: str) -> dict[str, Any]:
        """Return the ROS name and the Zenoh key of a topic or action."""
        ros = settings.topic(name)
        return {"ros": ros, "key": dialect.data_key(settings.domain, ros, "", NO_HASH)}

    def topic_plan(
        name: str, kind: str, reliable: bool, latched: bool = False, on_events: bool = False
    ) -> dict[str, Any]:
        """Return the entry of a topic: names, message type and quality of service."""
        latched = latched or name in LATCHED
        quality = {"reliable": reliable or latched, "latched": latched, "on_events": on_events}
        return {**names_of(name), "type": kind, **quality, "depth": _DEPTHS.get(name, _DEPTH)}

    reliable_topics = settings.adapter.reliable
    received = [
        topic_plan(name, accepted_types(name, settings.topic(name))[0], name in reliable_topics)
        for name in SUBSCRIBED
        if config.sensors.second_camera is not None or not name.startswith("camera2/")
    ]
    by_action = settings.goals == "navigate_to_pose"
    unused = {"goal"} if by_action else set()
    if not settings.keepout_filter:
        unused |= {"keepout_mask", "keepout_info"}
    if settings.detections_frame is None:
        unused |= {"detections", "objects"}
    # A button may be best effort. A reliable subscription repeats what a reliable button lost, and
    # only a latched one gets a stop from before. A stop that comes more than once does no harm.
    for reliable, latched in ((False, False), (True, False), (True, True)):
        received.append(topic_plan("stop", BOOL, reliable, latched, on_events=True))
    if settings.requests:
        received.append(topic_plan("request", STRING, reliable=True, on_events=True))
    else:
        unused.add("answer")
    published = [name for name in PUBLISHED if name not in unused]
    return {
        "version": version("eclipse-zenoh"),
        "zenoh": str(session_config(config.zenoh, "connect")),
        "node": f"{settings.node}_adapter",
        "max_bytes": int(config.source.max_message_mb * 1e6),
        "heard": received,
        "said": [topic_plan(name, PUBLISHED[name], reliable=True) for name in published],
        "action": {**names_of("navigate_to_pose"), "type": NAVIGATE_TO_POSE} if by_action else None,
    }


def command_of(config: Config) -> list[str]:
    """Return the command that starts the node.

    Raises:
        UnavailableError: a file in the configuration cannot be read.
    """
    adapter = config.ros2.adapter
    for key, path in (("python", adapter.python), ("setup", adapter.setup)):
        if path is not None and not os.access(path, os.R_OK):
            raise UnavailableError(f"{config.locate(f'ros2.adapter.{key}')}: cannot read {path}")
    start = [adapter.python, "-u", str(NODE)]
    if adapter.setup is None:
        return start
    # A setup file may read its input, and may return the status of its last command.
    script = f"source {shlex.quote(adapter.setup)} </dev/null; exec {shlex.join(start)}"
    return ["bash", "-c", script]


def supervise(config: Config, stop: threading.Event) -> int:
    """Keep the node running until `stop` is set; return the exit code.

    Raises:
        ConfigError: see `make_plan`.
        UnavailableError: a restart would not help.
    """
    plan, command, ends = make_plan(config), command_of(config), 0
    while not stop.is_set():
        begun_s = time.monotonic()
        code = _run_node(command, plan, stop)
        if stop.is_set():
            break
        if code == os.EX_UNAVAILABLE:
            message = "ros2-adapter: the adapter's node cannot run here: see the error above"
            raise UnavailableError(message)
        ends = 1 if time.monotonic() - begun_s > _STABLE_S else ends + 1
        pause_s = pause_after(ends, _PAUSE_S, _LONGEST_PAUSE_S)
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        log.warning("the adapter's node ended (%s): starting it again in %g s", how, pause_s)
        stop.wait(pause_s)
    return os.EX_OK


def _run_node(command: list[str], plan: dict[str, Any], stop: threading.Event) -> int:
    """Run the node until it ends or `stop` is set; return its exit code."""
    environ = {k: v for k, v in os.environ.items() if not k.startswith("EDGE__")}
    # With its own session, Ctrl-C in a terminal reaches only this process. The node ends when its
    # input closes, so it never outlives this process.
    node = subprocess.Popen(command, stdin=subprocess.PIPE, env=environ, start_new_session=True)
    try:
        with suppress(BrokenPipeError):
            node.stdin.write(json.dumps(plan).encode() + b"\n")
            node.stdin.flush()
        while node.poll() is None and not stop.wait(_POLL_S):
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
