"""Puts a service together from a configuration, and starts `edge` commands beside it."""

from __future__ import annotations

import gc
import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, BinaryIO

import zenoh

from edge.bus.presence import Presence
from edge.bus.requests import RequestServer
from edge.bus.session import ENVELOPE_BYTES, zenoh_session
from edge.config import Config
from edge.config.environment import READ, is_ours
from edge.errors import UserError
from edge.host import calibration, resources
from edge.host.children import python_module
from edge.host.interruptible import raise_if_stopped, unless_stopped
from edge.host.memory import trimmed
from edge.host.ports import free_port
from edge.host.repeated import repeated
from edge.loop import requests
from edge.loop.checkpoint import ServiceCheckpoint
from edge.loop.result import Sink
from edge.loop.runner import Running
from edge.loop.scorers import make_scorers
from edge.loop.service import Service
from edge.loop.source import Source
from edge.loop.warmup import warm_up
from edge.memory import SiteFile
from edge.mission.brief import Brief
from edge.perception.detection.detector import Detector
from edge.perception.detection.sim import TruthAt
from edge.perception.factory import make_detector
from edge.perception.masks.masker import make_masker
from edge.perception.runtime.cards import ModelError
from edge.perception.runtime.health import Health, log_progress
from edge.perception.worker import DetectorWorker
from edge.policies import find_policy
from edge.sinks import find_sinks
from edge.sources import find_source
from edge.sources.truth import make_truth
from edge.tasks.brief import prepared

log = logging.getLogger("edge")
_SWITCH_S = 2e-4
_CHILD_STOP_S = 5.0
_CHILD_LOOK_S = 0.2


@dataclass
class Launched(Running):
    """A running service, its session on the bus, and its sinks."""

    session: zenoh.Session
    sinks: Sequence[Sink]


@contextmanager
def open_service(
    config: Config,
    sinks: Sequence[Sink],
    asked: str | None = None,
    formula: str | None = None,
    task: str | None = None,
    stop: threading.Event | None = None,
    progress: Callable[[str], None] = lambda what: None,
    amiss: Callable[[], Sequence[str]] = tuple,
    make_source: Callable[..., Source] | None = None,
) -> Iterator[Launched]:
    """Prepare the mission, open Zenoh, load the detector, compile kernels; all closed at exit.

    Zenoh comes before what takes long: where another service has the endpoint, that is known at
    once. Who connects early finds nobody to take requests until all is ready.

    Args:
        sinks: take the results besides those that the configuration names.
        asked: the configuration's mission, where the command line named it.
        formula: the mission, in place of the configuration's; so `task` (`edge.tasks.brief`).
            With none of them a checkpoint's unfinished mission goes on, whatever the configuration
            says.
        stop: once set, the start is broken off. What cannot be, as compiling, is left to a thread
            (`edge.host.interruptible`).
        progress: told what is begun, by any thread: each takes minutes at most, and what takes
            longer is told again and again.
        amiss: why nobody can count on the service now, for whoever asks on the bus.
        make_source: makes another source than the configuration names; see `find_source`.

    Raises:
        Stopped: `stop` was set before the service was ready.
        ConfigError: there is no such source, sink or policy, or it cannot be made.
        UserError: the mission is not understood or cannot be done.
        CheckpointError: `mission.checkpoint` cannot be read or written.
        ModelError: the detector's or a scorer's model is missing or unusable.
        ChatError: the URL of a scorer's server cannot be used.
        BusError: the endpoint cannot be listened on, or another service has the prefix.
    """
    stop = stop or threading.Event()
    make_source, make_sinks = make_source or find_source(config), find_sinks(config)
    make_policy = find_policy(config.policy, config.origin("policy"))
    if not any(sink.kind in ("zenoh", "ros2") or ":" in sink.kind for sink in config.sinks):
        log.warning("%s: neither zenoh nor ros2: no motion controller hears a goal",
                    config.at("sinks"))  # fmt: skip
    with ExitStack() as stack:
        mission, checkpoint, brief = config.mission, None, None
        site = SiteFile(None if mission.site is None else resources.expand(mission.site))
        stack.callback(site.close)
        if mission.checkpoint is not None:
            named = next((text for text in (task, formula, asked) if text is not None), None)
            checkpoint = ServiceCheckpoint(config, resources.expand(mission.checkpoint), named)
            stack.callback(checkpoint.close)
            brief = checkpoint.brief()
        idle = mission.on_request and brief is None and {asked, formula, task} == {None}
        if brief is None:
            progress("understanding the mission")
            brief = prepared(config, task, site.known, formula=formula)
        raise_if_stopped(stop)
        session = stack.enter_context(
            zenoh_session(
                config.zenoh,
                "listen",
                stop,
                exact=config.loop.lockstep,
                most_bytes=int(config.source.max_message_mb * 1e6) + ENVELOPE_BYTES,
                tell=progress,
            )
        )
        presence = Presence(session, config.zenoh)
        stack.callback(presence.close)
        policy = unless_stopped(make_policy, stop)
        # Made before what takes long: a port may be taken, and one's own may fail.
        every = [*(make(config=config, session=session) for make in make_sinks), *sinks]
        for sink in every:
            stack.callback(sink.close)
        source = make_source(config=config, session=session)
        stack.callback(source.close)
        lockstep = config.loop.lockstep
        masker = unless_stopped(partial(make_masker, config.perception, not lockstep), stop)
        progress("loading the detector")
        detector = _load(config, brief.prompts, make_truth(config, session), stop, progress)
        worker = DetectorWorker(detector, lockstep, masker)
        stack.callback(worker.close)
        progress("loading the scorers")
        scorers = unless_stopped(partial(make_scorers, config, brief.prompts), stop)
        if scorers is not None:
            stack.callback(scorers.close)
        unless_stopped(partial(warm_up, config, progress), stop)
        raise_if_stopped(stop)
        servers: dict[str, RequestServer] = {}

        def overruns() -> dict[str, int]:
            """Looks that found a ring full once more (see `edge.bus.session.Ring`)."""
            return {
                "sensors": source.counters.get("overrun", 0),
                "goal_status": source.inbox.overruns,
                **{key: server.overruns for key, server in servers.items()},
            }

        service = Service(
            config, brief, worker, policy, every, checkpoint, scorers, overruns,
            calibration.load(), idle, inputs=getattr(source, "input_table", tuple), site=site,
        )  # fmt: skip
        stack.callback(service.close)

        def prepare(**request: Any) -> Brief:
            return prepared(config, site=site.known, **request)

        served = requests.served(service, prepare, amiss)
        for key, (verbs, handle) in served.items():
            servers[key] = RequestServer(session, config.zenoh.key(key), verbs, handle)
            stack.callback(servers[key].close)
        presence.announce()
        # What start-up made stays for good; the collector need not walk it again in the loop.
        gc.collect()
        gc.freeze()
        stack.callback(gc.unfreeze)
        # Kernels give the interpreter lock away; by default the loop then waits up to 5 ms for the
        # detector's or the sink's thread to give it back, more than a whole tick's budget.
        stack.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(_SWITCH_S)
        if not lockstep:
            stack.enter_context(trimmed())
        yield Launched(config, service, worker, source, servers, session, every)


def _load(
    config: Config,
    targets: Sequence[str],
    truth: TruthAt | None,
    stop: threading.Event,
    progress: Callable[[str], None],
) -> Detector:
    """See `make_detector`; raises Stopped once `stop` is set."""

    def tell(health: Health) -> None:
        log_progress(health)
        progress(f"{health.state}: {health.detail}")

    make = partial(make_detector, config.perception, targets, tell, cancelled=stop, truth=truth)
    if config.perception.isolation == "thread":
        return unless_stopped(make, stop)
    try:
        return make()
    except ModelError:
        raise_if_stopped(stop)
        raise


def on_a_free_port(config: Config) -> Config:
    """The configuration, with an endpoint on this machine that nobody has. It needs no router, and
    none of the certificates that `zenoh.file` may ask for."""
    change = {
        "endpoint": f"tcp/127.0.0.1:{free_port()}", "mode": "peer", "file": None,
        "client_file": None,
    }  # fmt: skip
    return config.model_copy(update={"zenoh": config.zenoh.model_copy(update=change)})


@contextmanager
def children(
    config: Config, stop: threading.Event, *commands: tuple[str, ...]
) -> Iterator[list[subprocess.Popen[bytes]]]:
    """`edge COMMAND` processes with this configuration; they end with the block.

    A child gets the whole configuration in a file, since the environment's overrides and `--target`
    are already in it. Variables of the environment that nothing reads were told of here.

    Args:
        stop: set when a child ends before the block does: there is nothing to go on with.

    Raises:
        UserError: a child could not be started, or ended by itself.
    """
    environ = {k: v for k, v in os.environ.items() if k in READ or not is_ours(k)}
    started: list[subprocess.Popen[bytes]] = []
    with _in_memory(config) as file:
        path = f"/proc/self/fd/{file.fileno()}"
        try:
            for command, *options in commands:
                arguments = [*python_module("edge.cli"), "--log-level", "warning"]
                arguments += [command, path, "--with-parent", str(os.getpid()), *options]
                try:
                    # A session of its own keeps the terminal's Ctrl-C for the parent, which
                    # stops its children in order.
                    child = subprocess.Popen(
                        arguments, env=environ, start_new_session=True, pass_fds=(file.fileno(),)
                    )
                except OSError as error:
                    named = " ".join([command, *options])
                    raise UserError(f"cannot start edge {named}: {error.strerror}") from None
                started.append(child)
            with _watched(started, stop):
                yield started
            _check(list(map(" ".join, commands)), started)
        finally:
            _stop(started)


def _in_memory(config: Config) -> BinaryIO:
    """A file with the configuration and no name: nothing is left of it however this process ends,
    and none but children can read what secrets it holds."""
    file = open(os.memfd_create("edge-config"), "wb")  # noqa: SIM115
    file.write(config.model_dump_json(exclude={"path"}).encode())
    file.flush()
    return file


def _watched(
    started: list[subprocess.Popen[bytes]], stop: threading.Event
) -> AbstractContextManager[None]:
    """Sets `stop` as soon as one of the processes ends."""

    def look() -> None:
        if any(child.poll() is not None for child in started):
            stop.set()

    return repeated("children", _CHILD_LOOK_S, look)


def _check(names: list[str], started: list[subprocess.Popen[bytes]]) -> None:
    """Raises UserError for the first process that has ended by itself."""
    for name, child in zip(names, started, strict=True):
        code = child.poll()
        if code is not None:
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            error = UserError(f"edge {name} ended before its time ({how}): see what it said above")
            error.exit_code = code if code > 0 else os.EX_SOFTWARE
            raise error


def _stop(started: list[subprocess.Popen[bytes]]) -> None:
    for child in started:
        with suppress(ProcessLookupError):
            child.send_signal(signal.SIGTERM)
    for child in started:
        try:
            child.wait(_CHILD_STOP_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
