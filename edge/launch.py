"""Builder of the service from a configuration, and starter of `edge` child processes."""

from __future__ import annotations

import gc
import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, BinaryIO

import zenoh

from edge.bus.presence import Presence
from edge.bus.requests import RequestServer
from edge.bus.ros2.requests import serve_ros2_requests, serve_ros2_stop
from edge.bus.session import ENVELOPE_BYTES, zenoh_session
from edge.bus.stop import StopRequests, StopServer, stop_requests
from edge.config import Config
from edge.config.environment import KNOWN_VARIABLES, is_ours
from edge.errors import UserError
from edge.host import calibration, resources
from edge.host.children import python_module
from edge.host.interruptible import raise_if_stopped, run_unless_stopped
from edge.host.memory import trim_memory_periodically
from edge.host.periodic import run_periodically
from edge.host.ports import free_port
from edge.host.stop_latch import RETRY_S, StopLatch
from edge.live.agent_view import AgentView
from edge.loop.checkpoints.checkpoint import ServiceCheckpoint
from edge.loop.requests.agent_requests import agent_handlers
from edge.loop.requests.handlers import prepare_new, request_handlers
from edge.loop.result import Sink
from edge.loop.runner import RunningService
from edge.loop.scoring.scorers import Scorers, make_scorers
from edge.loop.service import Service
from edge.loop.source import Source
from edge.loop.warmup import warm_up
from edge.memory import SiteFile
from edge.mission.spec import MissionSpec
from edge.perception.detection.detector import Detector
from edge.perception.detection.sim import TruthAt
from edge.perception.factory import make_detector
from edge.perception.masks.ground import GroundClassifier, make_ground_classifier
from edge.perception.masks.masker import make_masker
from edge.perception.runtime.cards import ModelError
from edge.perception.runtime.health import ModelHealth, log_progress
from edge.perception.worker import DetectorWorker
from edge.policies import find_policy
from edge.sinks import find_sinks
from edge.sources import find_source
from edge.sources.truth import make_ground_truth
from edge.tasks.mission_spec import prepare_mission

log = logging.getLogger("edge")
_SWITCH_S = 2e-4  # switch interval of the interpreter lock between threads; Python's is 5 ms
_CHILD_STOP_S = 5.0  # time for a child process to end after SIGTERM, before it is killed
_CHILD_CHECK_S = 0.2  # period of the checks if a child process has ended


@dataclass(kw_only=True)
class LaunchedService(RunningService):
    """A running service with its Zenoh session and its sinks."""

    session: zenoh.Session
    sinks: Sequence[Sink]


@contextmanager
def open_service(
    config: Config,
    sinks: Sequence[Sink],
    instruction: str | None = None,
    formula: str | None = None,
    task: str | None = None,
    stop: threading.Event | None = None,
    progress: Callable[[str], None] = lambda what: None,
    problems: Callable[[], Sequence[str]] = tuple,
    make_source: Callable[..., Source] | None = None,
    latch: StopLatch | None = None,
    clock: Callable[[], int] | None = None,
) -> Iterator[LaunchedService]:
    """Prepare the mission, open Zenoh, load the detector and compile kernels; close all at exit.

    Zenoh is opened before the slow steps. If another service has the endpoint, the start fails at
    once. Requests are answered only when the service is ready.

    Args:
        config: The configuration.
        sinks: Sinks in addition to those of the configuration.
        instruction: The mission of the configuration, if the command line set it; else None.
        formula: A formula that replaces the mission of the configuration.
        task: A task that replaces the mission of the configuration (`edge.tasks.mission_spec`). If
            `instruction`, `formula` and `task` are all None, the unfinished mission of a checkpoint
            continues. It then takes precedence over the configuration.
        stop: Event that cancels the start. A step that cannot be interrupted, such as compiling,
            is left to a background thread (`edge.host.interruptible`).
        progress: Function that is called, by any thread, with the step that begins. A step that
            takes several minutes calls it again and again.
        problems: Function that returns the reasons why the service is not ready, one line each, for
            requests on the bus.
        make_source: Function that makes a source other than that of the configuration; see
            `find_source`.
        latch: The stop of the robot, which takes requests before the slow steps; None: a new one,
            which ends with the service.
        clock: See `RunningService`.

    Yields:
        The service, ready for `edge.loop.runner.loop`.

    Raises:
        Stopped: `stop` was set before the service was ready.
        ConfigError: A source, sink or policy does not exist or cannot be made.
        UserError: The mission is not understood or cannot be done.
        CheckpointError: `mission.checkpoint` cannot be read or written.
        ModelError: The model of the detector or of a scorer is missing or unusable.
        ChatError: The URL of a scorer's server cannot be used.
        BusError: The endpoint cannot be listened on, or another service has the prefix.
    """
    stop, latch = stop or threading.Event(), latch or StopLatch()
    is_played, make_source = make_source is not None, make_source or find_source(config)
    make_sinks = find_sinks(config)
    make_policy = find_policy(config.policy, config.origin("policy"))
    _warn_without_controller(config, is_played)
    with ExitStack() as stack:
        mission = config.mission
        site = SiteFile(None if mission.site is None else resources.expand(mission.site))
        stack.callback(site.close)
        given = next((text for text in (task, formula, instruction) if text is not None), None)
        checkpoint = _open_checkpoint(stack, config, given)
        spec = None if checkpoint is None else checkpoint.saved_spec()
        # Start without a mission: none was given, and none continues from the checkpoint.
        idle = mission.on_request and spec is None and given is None
        if spec is None:
            progress("understanding the mission")
            spec = prepare_mission(config, task, site.known, formula=formula)
        raise_if_stopped(stop)
        session, presence = _open_bus(stack, config, stop, progress)
        stop_queues = _serve_stop(stack, config, session, latch)
        policy = run_unless_stopped(make_policy, stop)
        view = AgentView()
        # Sinks are made before the slow steps: a port may be in use, and a plugin may fail.
        all_sinks = [*(make(config=config, session=session) for make in make_sinks), *sinks]
        if config.mcp is not None:
            all_sinks.append(view)
        for sink in all_sinks:
            stack.callback(sink.close)
        source = make_source(config=config, session=session)
        stack.callback(source.close)
        worker, scorers, ground = _load_models(stack, config, spec.prompts, session, stop, progress)
        run_unless_stopped(partial(warm_up, config, progress), stop)
        raise_if_stopped(stop)
        service = Service(
            config, spec, worker, policy, all_sinks, checkpoint, scorers, calibration.load(), idle,
            site=site, ground=ground,
        )  # fmt: skip
        stack.callback(service.close)
        servers = _serve_requests(stack, service, session, view, problems, stop_queues)
        service.parts_status.overruns = partial(_overruns, source, servers)
        service.parts_status.inputs = getattr(source, "input_table", tuple)
        presence.announce()
        _tune_interpreter(stack)
        if not config.loop.lockstep:
            stack.enter_context(trim_memory_periodically())
        yield LaunchedService(
            config=config, service=service, worker=worker, source=source, servers=servers,
            latch=latch, clock=clock, session=session, sinks=all_sinks,
        )  # fmt: skip


def _warn_without_controller(config: Config, is_played: bool) -> None:
    """Warn if no motion controller receives goals; a recording needs none."""
    # A kind with a colon is a plugin, `module:Class`, which may send goals, too.
    sends_goals = any(s.kind in ("zenoh", "ros2") or ":" in s.kind for s in config.sinks)
    if not (sends_goals or is_played):
        log.warning("%s: no zenoh or ros2 sink: no motion controller receives goals; add such "
                    "a sink to drive a robot", config.locate("sinks"))  # fmt: skip


def _open_checkpoint(
    stack: ExitStack, config: Config, given: str | None
) -> ServiceCheckpoint | None:
    """Open the configured checkpoint, if any; `given` is the mission of the command line."""
    path = config.mission.checkpoint
    if path is None:
        return None
    checkpoint = ServiceCheckpoint(config, resources.expand(path), given)
    stack.callback(checkpoint.close)
    return checkpoint


def _open_bus(
    stack: ExitStack, config: Config, stop: threading.Event, progress: Callable[[str], None]
) -> tuple[zenoh.Session, Presence]:
    """Open the Zenoh session, and claim the prefix for this service."""
    session = stack.enter_context(
        zenoh_session(
            config.zenoh,
            "listen",
            stop,
            keep_zenoh_timeout=config.loop.lockstep,
            most_bytes=int(config.source.max_message_mb * 1e6) + ENVELOPE_BYTES,
            report=progress,
        )
    )
    presence = Presence(session, config.zenoh)
    stack.callback(presence.close)
    return session, presence


def _serve_stop(
    stack: ExitStack, config: Config, session: zenoh.Session, latch: StopLatch
) -> dict[str, StopRequests]:
    """Serve requests to stop the robot, which must not wait for the slow steps."""
    queues = stop_requests(latch)
    stack.callback(StopServer(session, config.zenoh, queues).close)
    stack.enter_context(run_periodically("stop", RETRY_S, latch.keep))
    if "ros2" in (config.source.kind, *(sink.kind for sink in config.sinks)):
        stack.enter_context(serve_ros2_stop(config, session, latch.stop))
    return queues


def _load_models(
    stack: ExitStack,
    config: Config,
    targets: Sequence[str],
    session: zenoh.Session,
    stop: threading.Event,
    progress: Callable[[str], None],
) -> tuple[DetectorWorker, Scorers | None, GroundClassifier | None]:
    """Load the segmenter, the ground classifier, the detector and the scorers."""
    lockstep = config.loop.lockstep  # the loop waits for each result, so that a run replays
    masker = run_unless_stopped(partial(make_masker, config.perception, not lockstep), stop)
    ground = run_unless_stopped(partial(make_ground_classifier, config.tasks), stop)
    progress("loading the detector")
    truth = make_ground_truth(config, session)
    detector = _load_detector(config, targets, truth, stop, progress)
    worker = DetectorWorker(detector, lockstep, masker)
    stack.callback(worker.close)
    progress("loading the scorers")
    scorers = run_unless_stopped(partial(make_scorers, config, targets), stop)
    if scorers is not None:
        stack.callback(scorers.close)
    return worker, scorers, ground


def _serve_requests(
    stack: ExitStack,
    service: Service,
    session: zenoh.Session,
    view: AgentView,
    problems: Callable[[], Sequence[str]],
    stop_queues: Mapping[str, StopRequests],
) -> dict[str, RequestServer]:
    """Start the servers of all requests but stops, and return them by key."""
    config = service.config
    servers: dict[str, RequestServer] = {}

    def prepare(**request: Any) -> MissionSpec:
        return prepare_mission(service.config, site=service.site.known, **request)

    handlers = request_handlers(service, prepare, problems)
    if config.mcp is not None:
        handlers |= agent_handlers(service, config.mcp, partial(prepare_new, prepare), view.picture)
    for key, (verbs, handle) in handlers.items():
        servers[key] = RequestServer(session, config.zenoh.key(key), verbs, handle)
        stack.callback(servers[key].close)
    if config.ros2.requests:
        queues = {**{key: server.queue for key, server in servers.items()}, **stop_queues}
        stack.enter_context(serve_ros2_requests(config, session, queues))
    return servers


def _overruns(source: Source, servers: Mapping[str, RequestServer]) -> dict[str, int]:
    """Return the number of reads that found a ring full (see `edge.bus.session.Ring`)."""
    return {
        "sensors": source.counters.get("overrun", 0),
        "goal_status": source.inbox.overruns,
        **{key: server.overruns for key, server in servers.items()},
    }


def _tune_interpreter(stack: ExitStack) -> None:
    """Set garbage collector and interpreter lock for the loop, until the stack is closed."""
    # Objects of the start-up are never freed, so the collector need not scan them in the loop.
    gc.collect()
    gc.freeze()
    stack.callback(gc.unfreeze)
    # Kernels release the interpreter lock. With the default switch interval, the loop would wait
    # up to 5 ms for the detector's or a sink's thread to return it: more than the budget of a tick.
    stack.callback(sys.setswitchinterval, sys.getswitchinterval())
    sys.setswitchinterval(_SWITCH_S)


def _load_detector(
    config: Config,
    targets: Sequence[str],
    truth: TruthAt | None,
    stop: threading.Event,
    progress: Callable[[str], None],
) -> Detector:
    """Make the detector (see `make_detector`)."""

    def report(health: ModelHealth) -> None:
        log_progress(health)
        progress(f"{health.state}: {health.detail}")

    make = partial(make_detector, config.perception, targets, report, cancelled=stop, truth=truth)
    if config.perception.isolation == "thread":
        return run_unless_stopped(make, stop)
    try:
        return make()
    except ModelError:
        raise_if_stopped(stop)
        raise


def with_free_port(config: Config) -> Config:
    """Return the configuration with a free local endpoint.

    This endpoint works without a router and without the certificates in `zenoh.file`.
    """
    change = {
        "endpoint": f"tcp/127.0.0.1:{free_port()}", "mode": "peer", "file": None,
        "client_file": None,
    }  # fmt: skip
    return config.model_copy(update={"zenoh": config.zenoh.model_copy(update=change)})


@contextmanager
def child_processes(
    config: Config, stop: threading.Event, *commands: tuple[str, ...]
) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Run `edge COMMAND` processes with this configuration until the block ends.

    A child reads the entire configuration from a file, which already includes `--target` and the
    overrides of the environment. Unknown EDGE variables are not passed on, because this process
    has already warned about them.

    Args:
        config: The configuration of the children.
        stop: Event that is set when a child ends before the block does, because the block cannot
            continue without it.
        *commands: Command and options of each child.

    Yields:
        The processes, in the order of `commands`.

    Raises:
        UserError: A child could not be started, or ended by itself.
    """
    environ = {k: v for k, v in os.environ.items() if k in KNOWN_VARIABLES or not is_ours(k)}
    started: list[subprocess.Popen[bytes]] = []
    with _write_to_memory_file(config) as file:
        path = f"/proc/self/fd/{file.fileno()}"
        try:
            for command, *options in commands:
                arguments = [*python_module("edge.cli"), "--log-level", "warning"]
                arguments += [command, path, "--with-parent", str(os.getpid()), *options]
                try:
                    # In a new session, Ctrl-C reaches only the parent, which stops its children
                    # in order.
                    child = subprocess.Popen(
                        arguments, env=environ, start_new_session=True, pass_fds=(file.fileno(),)
                    )
                except OSError as error:
                    shown = " ".join([command, *options])
                    raise UserError(f"cannot start `edge {shown}`: {error.strerror}") from None
                started.append(child)
            with _watch(started, stop):
                yield started
            _check_children(list(map(" ".join, commands)), started)
        finally:
            _stop_children(started)


def _write_to_memory_file(config: Config) -> BinaryIO:
    """Return an unnamed in-memory file with the configuration.

    Nothing of it remains after the process ends, and only the children can read its secrets.
    """
    file = open(os.memfd_create("edge-config"), "wb")  # noqa: SIM115
    file.write(config.model_dump_json(exclude={"path"}).encode())
    file.flush()
    return file


def _watch(
    started: list[subprocess.Popen[bytes]], stop: threading.Event
) -> AbstractContextManager[None]:
    """Set `stop` as soon as one of the processes ends."""

    def check() -> None:
        if any(child.poll() is not None for child in started):
            stop.set()

    return run_periodically("children", _CHILD_CHECK_S, check)


def _check_children(names: list[str], started: list[subprocess.Popen[bytes]]) -> None:
    """Raise UserError for the first process that has ended by itself."""
    for name, child in zip(names, started, strict=True):
        code = child.poll()
        if code is not None:
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            error = UserError(f"`edge {name}` ended too early ({how}): see its messages above")
            error.exit_code = code if code > 0 else os.EX_SOFTWARE
            raise error


def _stop_children(started: list[subprocess.Popen[bytes]]) -> None:
    for child in started:
        with suppress(ProcessLookupError):
            child.send_signal(signal.SIGTERM)
    for child in started:
        try:
            child.wait(_CHILD_STOP_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
