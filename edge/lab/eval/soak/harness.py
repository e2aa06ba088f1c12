"""Harness of `edge soak`: processes of service, robot, controller and router, and the relay."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from typing import Any

import httpx
import yaml
import zenoh

from edge.bus import topics
from edge.bus.client import send_request
from edge.bus.session import zenoh_session
from edge.config import Config, DetectorOnnx, WorldGenerated, ZenohConfig
from edge.config.yaml_text import read_yaml
from edge.errors import UserError
from edge.host import resources
from edge.host.files import write_atomically
from edge.host.interruptible import raise_if_stopped
from edge.host.ports import free_port
from edge.host.processes import Process, descendants
from edge.lab.eval.soak import recordings
from edge.lab.eval.soak.children import STOP_S, ChildProcesses
from edge.lab.eval.soak.log import PipeLog
from edge.lab.eval.soak.relay import Relay
from edge.perception.runtime.cards import card_path, load_detector_card

TWIN, BROKEN = "soak-twin", "soak-broken"
"""Names of models: a copy of the configured one, and one that cannot be loaded."""
ANSWER_S = 5.0  # longest wait for an answer to a request
START_S = 900.0  # the first start compiles kernels, on a machine that may be busy
_HTTP_S = 2.0  # longest wait for a page
_CHECK_PERIOD_S = 0.1  # time between two checks of a condition
_HOUSE_DISTANCE_M = 60.0  # between two houses: too far for a robot to have driven
# In the command line of the process of the service's model.
_MODEL_COMMAND = re.compile(r"\bedge\.perception\.serve_detector\b")


def soak_config(config: Config, out: Path) -> Config:
    """Return the configuration with free ports, and with all files below `out`.

    Raises:
        UserError: it runs in lockstep, and not in real time.
    """
    if config.loop.lockstep or config.sim.lockstep:
        where = config.locate("loop.lockstep", "sim.lockstep")
        raise UserError(
            f"{where}: edge soak runs in real time; set loop.lockstep and sim.lockstep to false"
        )
    zenoh = {"endpoint": _endpoint(), "file": None, "client_file": None}
    http = {"host": "127.0.0.1", "port": free_port(), "token_file": None}
    checkpoint = {"checkpoint": str(out / "checkpoint.json")}
    return config.model_copy(
        update={
            "zenoh": config.zenoh.model_copy(update=zenoh),
            "http": config.http.model_copy(update=http),
            "mission": config.mission.model_copy(update=checkpoint),
            "sinks": recordings.move_folders(config.sinks, out),
        }
    )


def _endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


class SoakHarness:
    """Runs the service and all processes around it until it is closed.

    Attributes:
        config_file: the service's configuration.
        children: all processes that this one has started.
        service: process of the service; it is never started again.
        house: number of the robot's house, from 0.
        session: Zenoh session for requests and subscriptions.
        relay: passes on the messages between robot and service.
        family: all processes that the service and its children have ever started.
    """

    def __init__(self, config: Config, out: Path, stop: threading.Event) -> None:
        self.config, self.out = config, out
        self.config_file = out / "config.yaml"
        self.house = 0
        self.family: set[Process] = set()
        self._stop = stop
        environ = {k: v for k, v in os.environ.items() if not k.startswith("EDGE__")}
        environ["EDGE_CACHE_DIR"] = str(_make_cache(config, out / "cache"))
        self._robot_zenoh = ZenohConfig(endpoint=_endpoint(), prefix=config.zenoh.prefix)
        self.log = PipeLog(out / "service.pipe", out / "service.log")
        self._output = (out / "others.log").open("wb")
        self.children = ChildProcesses(environ, self._output)
        self._http = httpx.Client(base_url=f"http://127.0.0.1:{config.http.port}", timeout=_HTTP_S)
        self.write_config()

    # -- start and end --------------------------------------------------------------------------

    def start(self) -> None:
        """Start the service first, then the processes that connect to it.

        Raises:
            Stopped: `stop` was set before all had started.
            UserError: a process ended before that, or took too long.
        """
        self.start_router()
        with os.fdopen(self.log.writer(), "wb") as output:
            self.service = self.children.start("service", "run", str(self.config_file), out=output)
        self._wait_until(
            lambda: self.page("/readyz")[1].get("state") == "running",
            "edge run: the service did not start",
        )
        self._session_context = zenoh_session(self.config.zenoh, "connect", self._stop)
        self.session = self._session_context.__enter__()
        self.relay = Relay(self._robot_zenoh, self.config.zenoh, self._stop)
        self.start_simulator()
        self.start_controller()
        self._wait_until(
            lambda: self.page("/readyz")[0] == HTTPStatus.OK,
            "the service is not ready, although simulator and controller run",
        )

    def _wait_until(self, is_true: Callable[[], bool], problem: str) -> None:
        deadline_s = time.monotonic() + START_S
        while not is_true():
            raise_if_stopped(self._stop)
            self.log.poll()
            if self.children.ended() or time.monotonic() > deadline_s:
                last_line = self.log.lines[-1][1] if self.log.lines else "no output"
                ended = [f"{name} has ended" for name in self.children.ended()]
                raise UserError(f"{problem}: {'; '.join([*ended, last_line])}")
            time.sleep(_CHECK_PERIOD_S)

    def close(self) -> None:
        """End all processes; the service last, as it should have ended before.

        `relay` and the session are missing if `start` has failed.
        """
        self.children.kill_all(but="service")
        if hasattr(self, "relay"):
            self.relay.close()
        if hasattr(self, "_session_context"):
            self._session_context.__exit__(None, None, None)
        self.children.kill("service")
        self.log.close()
        self._output.close()
        self._http.close()

    def stop_service(self) -> int | None:
        """Stop the service. Return its exit code; None if it has not ended in `STOP_S`."""
        self.service.send_signal(signal.SIGCONT)
        self.service.send_signal(signal.SIGTERM)
        deadline_s = time.monotonic() + STOP_S
        while self.service.poll() is None and time.monotonic() < deadline_s:
            self.log.poll()
            time.sleep(_CHECK_PERIOD_S)
        return self.service.poll()

    # -- processes ------------------------------------------------------------------------------

    def start_router(self) -> None:
        """Start the Zenoh router, if the configuration needs one."""
        if self.config.zenoh.mode == "client":
            command = ("fleet", "router", self.config.zenoh.endpoint, "--with-parent")
            self.children.start_module("router", "edge.cli", "--log-level", "warning", *command)

    def start_controller(self) -> None:
        """Start the motion controller."""
        self.children.start("controller", "sim", str(self.config_file), "--motion-only")

    def start_viewer(self) -> None:
        """Start a subscriber of all topics."""
        settings = self.config.zenoh
        self.children.start_module(
            "viewer", "edge.lab.eval.soak.viewer", settings.endpoint, settings.prefix
        )

    def start_simulator(self) -> None:
        """Start the robot, at the start of the present house."""
        config = self.config.model_copy(
            update={"zenoh": self._robot_zenoh, "sim": self.config.sim.model_copy(
                update={"world": self.world})}
        )  # fmt: skip
        path = self.out / "robot.yaml"
        write_atomically(path, config.model_dump_json(exclude={"path"}).encode())
        self.children.start("simulator", "sim", str(path), "--no-motion")

    @property
    def world(self) -> Any:
        """`sim.world` of the present house: the configured one, then generated ones."""
        configured = self.config.sim.world
        if self.house == 0:
            return configured
        first = configured.seed if isinstance(configured, WorldGenerated) else 0
        return WorldGenerated(kind="generated", seed=first + self.house)

    def start_next_house(self) -> None:
        """Restart the simulator in the next house; its place in `map` is far away."""
        self.children.kill("simulator", signal.SIGTERM)
        self.house += 1
        # Alternating: each house is far from the one before.
        self.relay.offset_m = _HOUSE_DISTANCE_M * (self.house % 2)
        self.start_simulator()

    def model_process(self) -> Process | None:
        """Return the process of the service's model; None if it has none now."""
        self.update_descendants()
        alive = (process for process in self.family if _MODEL_COMMAND.search(process.command))
        # Ended processes stay in `family`.
        return next((process for process in alive if process.is_running()), None)

    def update_descendants(self) -> None:
        """Add the present descendants of the service to `family`."""
        self.family.update(descendants(self.service.pid))

    def orphans(self) -> list[Process]:
        """Return the processes that the service has started and that still run."""
        return [process for process in self.family if process.is_running()]

    # -- requests and messages ------------------------------------------------------------------

    def page(self, path: str) -> tuple[int, dict[str, Any]]:
        """Return status and JSON of one of the service's pages; 0 without an answer in time."""
        try:
            answer = self._http.get(path)
            return answer.status_code, dict(answer.json())
        except (httpx.HTTPError, ValueError):
            return 0, {}

    def text(self, path: str) -> str:
        """Return the text of one of the service's pages; "" without an answer in time."""
        try:
            return self._http.get(path).raise_for_status().text
        except httpx.HTTPError:
            return ""

    def request_mission(self, **request: str) -> dict[str, Any]:
        """Send a mission request; return the answer (see `edge.bus.client.send_request`)."""
        key = self.config.zenoh.key(topics.MISSION_REQUEST)
        return send_request(self.session, key, request, ANSWER_S, "mission")

    def request_models(self, **request: object) -> dict[str, Any]:
        """Send a request about the model and return the answer."""
        key = self.config.zenoh.key(topics.MODELS_REQUEST)
        return send_request(self.session, key, request, ANSWER_S, "models")

    def put(self, topic_key: str, payload: bytes) -> None:
        """Publish a message on a topic."""
        with suppress(zenoh.ZError):
            self.session.put(self.config.zenoh.key(topic_key), payload)

    def write_config(self, **changes: dict[str, Any]) -> None:
        """Write the service's configuration with changed keys, by section.

        A section with a `kind` is replaced completely.
        """
        data = json.loads(self.config.model_dump_json(exclude={"path"}))
        for section, values in changes.items():
            data[section] = values if "kind" in values else {**data[section], **values}
        write_atomically(self.config_file, json.dumps(data, indent=1).encode())


def _make_cache(config: Config, folder: Path) -> Path:
    """Make a cache with links to the user's own and two more models (`TWIN`, `BROKEN`)."""
    models = folder / "models"
    models.mkdir(parents=True)
    _link_all(resources.cache_dir(), folder)
    _link_all(resources.models_dir(), models)
    detector = config.perception.detector
    if isinstance(detector, DetectorOnnx):
        card = load_detector_card(detector.model)
        card_data = read_yaml(card_path(detector.model))
        for name in (TWIN, BROKEN):
            changes = {"name": name, "file": f"{name}.onnx", "parity": None}
            text = yaml.safe_dump({**card_data, **changes}, sort_keys=False)
            (models / f"{name}.yaml").write_text(text, encoding="utf-8")
        shutil.copyfile(card.path, models / f"{TWIN}.onnx")
        (models / f"{BROKEN}.onnx").write_bytes(card.path.read_bytes()[:-1])  # cut off
    return folder


def _link_all(source: Path, target: Path) -> None:
    """Link each entry of a folder into another one that lacks it."""
    if source.is_dir():
        for entry in source.iterdir():
            if not (target / entry.name).exists():
                (target / entry.name).symlink_to(entry.resolve())
