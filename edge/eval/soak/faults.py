"""THE table of faults: how each is made, how long it lasts, what must hold then and after.

A fault is a generator: what comes before its first `yield` makes it, what follows each is done a
few times a second while it lasts, and its `finally` ends it.
"""

from __future__ import annotations

import math
import os
import resource
import signal
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np

from edge.bus import topics
from edge.config import Config
from edge.errors import UserError
from edge.eval.soak import relay
from edge.eval.soak.holds import (
    Hold,
    answers,
    blind,
    checkpoint_fails,
    checkpoint_written,
    says,
)
from edge.eval.soak.relay import Alter
from edge.eval.soak.stage import BROKEN, TWIN, Stage

Made = Generator[None, None, None]
Make = Callable[[Stage, np.random.Generator], Made]

_IMAGES = (topics.RGB, topics.DEPTH, topics.SEGMENTATION, topics.CAMERA_INFO)
_BATCH = 40  # messages of a flood at a time, of which there are several a second
_JUMP_M, _JUMP_RAD = 15.0, 2.0
_CLOCK_S = 3 * 3600.0
_LATE_S = 0.4


@dataclass(frozen=True)
class Fault:
    """One row.

    Attributes:
        what: how it is made, in words.
        lasts_s: at least and at most.
        within_s: after its end, in which `recovered` and `after` must hold, all of it at once.
        shows: what must hold at some time while it lasts.
        mutes: nothing that is published is heard while it lasts.
        needs: what of the configuration it is a fault of.
    """

    name: str
    what: str
    make: Make
    lasts_s: tuple[float, float] = (5.0, 10.0)
    within_s: float = 15.0
    shows: tuple[Hold, ...] = ()
    after: tuple[Hold, ...] = ()
    mutes: bool = False
    needs: Callable[[Config], bool] = lambda config: True


def _altered(make: Callable[[np.random.Generator], Alter]) -> Make:
    """The relay sends something else."""

    def fault(stage: Stage, rng: np.random.Generator) -> Made:
        stage.relay.alter = make(rng)
        try:
            while True:
                yield
        finally:
            stage.relay.alter = None

    return fault


def _sent(*payloads: Callable[[np.random.Generator], tuple[str, bytes]]) -> Make:
    """The soak publishes these again and again, by key, a batch at a time."""

    def fault(stage: Stage, rng: np.random.Generator) -> Made:
        while True:
            for make in payloads:
                for _ in range(_BATCH):
                    stage.put(*make(rng))
            yield

    return fault


def _late(stage: Stage, rng: np.random.Generator) -> Made:
    stage.relay.delay(_LATE_S)
    try:
        while True:
            yield
    finally:
        stage.relay.delay(0.0)


def _simulator_stopped(stage: Stage, rng: np.random.Generator) -> Made:
    stage.send("simulator", signal.SIGSTOP)
    try:
        while True:
            yield
    finally:
        stage.send("simulator", signal.SIGCONT)


def _next_house(stage: Stage, rng: np.random.Generator) -> Made:
    stage.move_house()
    while True:
        yield


def _cut(stage: Stage, rng: np.random.Generator) -> Made:
    stage.relay.cut()
    try:
        while True:
            yield
    finally:
        stage.relay.connect()


def _router_killed(stage: Stage, rng: np.random.Generator) -> Made:
    stage.kill("router")
    try:
        while True:
            yield
    finally:
        stage.start_router()


def _controller_killed(stage: Stage, rng: np.random.Generator) -> Made:
    stage.kill("controller")
    try:
        while True:
            yield
    finally:
        stage.start_controller()


def _model_signalled(number: int) -> Make:
    def fault(stage: Stage, rng: np.random.Generator) -> Made:
        process = stage.model_process()
        if process is None:
            raise UserError("the service's model has no process")
        os.kill(process.pid, number)
        while True:
            yield

    return fault


def _disk_full(stage: Stage, rng: np.random.Generator) -> Made:
    """No file that the service writes may grow, as on a full disk; what is open stays whole."""
    pid = stage.service.pid
    before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        while True:
            yield
    finally:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, before)


def _reloaded(*choices: dict[str, dict[str, object]]) -> Make:
    """Write one of these changes after the other, and have the service read it."""

    def fault(stage: Stage, rng: np.random.Generator) -> Made:
        present = stage.config_file.read_bytes()
        for changes in choices:
            stage.write_config(**changes)
            if stage.config_file.read_bytes() != present:
                break
        stage.service.send_signal(signal.SIGHUP)
        while True:
            yield

    return fault


def _badly_reloaded(stage: Stage, rng: np.random.Generator) -> Made:
    present = stage.config_file.read_bytes()
    bad = (b"mission: [", b'{"perception": {"detector": {"kind": "guess"}}}', present[:-9], b"\xff")
    stage.config_file.write_bytes(bad[rng.integers(len(bad))])
    stage.service.send_signal(signal.SIGHUP)
    try:
        while True:
            yield
    finally:
        stage.config_file.write_bytes(present)


def _swapped(stage: Stage, rng: np.random.Generator) -> Made:
    """To the twin, or back."""
    running = stage.models(do="status")
    own = stage.config.perception.detector.model  # type: ignore[union-attr]
    at_work = running["model"] if running["state"] in ("kept", "idle") else running["previous"]
    stage.models(do="use", model=own if at_work == TWIN else TWIN)
    while True:
        yield


def _badly_swapped(stage: Stage, rng: np.random.Generator) -> Made:
    stage.models(do="use", model=BROKEN)
    while True:
        yield


def _log_reader_gone(stage: Stage, rng: np.random.Generator) -> Made:
    """What it writes then has nowhere to go: at once where every thread is, later its log."""
    stage.log.leave()
    stage.service.send_signal(signal.SIGUSR1)
    try:
        while True:
            yield
    finally:
        stage.log.open()
        stage.service.send_signal(signal.SIGUSR1)


def _log_reader_stuck(stage: Stage, rng: np.random.Generator) -> Made:
    stage.log.stick()
    try:
        while True:
            yield
    finally:
        stage.log.open()


def _viewer_stopped(stage: Stage, rng: np.random.Generator) -> Made:
    stage.start_viewer()
    stops_s = time.monotonic() + 3.0  # once it is there
    try:
        while time.monotonic() < stops_s:
            yield
        stage.send("viewer", signal.SIGSTOP)
        while True:
            yield
    finally:
        stage.kill("viewer")


def _asked(make: Callable[[np.random.Generator], bytes]) -> Make:
    """Requests, whose answers nobody waits for."""

    def fault(stage: Stage, rng: np.random.Generator) -> Made:
        keys = [
            stage.config.zenoh.key(name) for name in (topics.MISSION_REQUEST, topics.MODELS_REQUEST)
        ]
        while True:
            for _ in range(_BATCH):
                stage.session.get(keys[rng.integers(2)], payload=make(rng), timeout=1.0)
            yield

    return fault


_REQUESTS = (b'{"do": "status"}', b'{"do": "resume"}')
_ANSWER = b'{"stamp": 1, "state": "accepted"}'


def _nonsense(rng: np.random.Generator) -> bytes:
    return relay.broken(b'{"do": "new", "instruction": "go to the bed"}', rng)


def _router(config: Config) -> bool:
    return config.zenoh.mode == "client"


def _process(config: Config) -> bool:
    return config.perception.isolation == "process"


def _onnx(config: Config) -> bool:
    return config.perception.detector.kind == "onnx"


FAULTS: tuple[Fault, ...] = (
    Fault("camera-gone", "the relay drops images", _altered(lambda rng: relay.nothing(_IMAGES)),
          shows=(blind,)),
    Fault("odometry-gone", "the relay drops odometry",
          _altered(lambda rng: relay.nothing((topics.ODOMETRY,))), shows=(blind,)),
    Fault("simulator-stopped", "SIGSTOP to the simulator", _simulator_stopped, shows=(blind,)),
    Fault("session-cut", "the relay's session with the bus is closed and opened again", _cut,
          shows=(blind,)),
    Fault("next-house", "the simulator starts again in another house", _next_house,
          within_s=40.0, after=(says("pose jumped"),)),
    Fault("image-frozen", "one image again and again, under new stamps",
          _altered(lambda rng: relay.frozen(True))),
    Fault("driver-frozen", "one image again and again, stamp and all",
          _altered(lambda rng: relay.frozen(False)), shows=(blind,)),
    Fault("messages-late", f"all of the sensors {_LATE_S:g} s late", _late),
    Fault("sensor-garbage", "before each message of the sensors a broken one",
          _altered(relay.garbage)),
    Fault("clock-ahead", "stamps of the sensors three hours ahead",
          _altered(lambda rng: relay.other_clock(_CLOCK_S))),
    Fault("clock-behind", "stamps of the sensors three hours behind",
          _altered(lambda rng: relay.other_clock(-_CLOCK_S))),
    Fault("pose-jump", f"odometry jumps {_JUMP_M:g} m and {math.degrees(_JUMP_RAD):.0f}°, and back",
          _altered(lambda rng: relay.elsewhere(_JUMP_M, _JUMP_RAD)),
          shows=(says("pose jumped"),)),
    Fault("router-killed", "kill -9 to the Zenoh router, which is started again", _router_killed,
          (2.0, 5.0), 25.0, mutes=True, needs=_router),
    Fault("controller-killed", "kill -9 to the motion controller, which is started again",
          _controller_killed),
    Fault("model-killed", "kill -9 to the model's process", _model_signalled(signal.SIGKILL),
          (4.0, 6.0), 40.0, needs=_process, shows=(says("ended by SIGKILL"),)),
    Fault("model-stopped", "SIGSTOP to the model's process", _model_signalled(signal.SIGSTOP),
          (8.0, 10.0), 40.0, needs=_process, shows=(says("no answer within"),)),
    Fault("model-swapped", "`edge models use` of the same model under another name", _swapped,
          (1.0, 2.0), 90.0, after=(says("model .*: kept"),), needs=_onnx),
    Fault("bad-model", "`edge models use` of a damaged model", _badly_swapped, (1.0, 2.0), 40.0,
          after=(says(f"model {BROKEN}: refused"),), needs=_onnx),
    Fault("reload", "SIGHUP with another `mission.verify_s`",
          _reloaded({"mission": {"verify_s": 2.5}}, {}), (1.0, 2.0), 30.0,
          after=(says("reload: switched"),)),
    Fault("policy-reload", "SIGHUP with another policy",
          _reloaded({"policy": {"kind": "nearest_frontier"}}, {}), (1.0, 2.0), 60.0,
          after=(says("reload: switched"),)),
    Fault("bad-reload", "SIGHUP with a configuration that is none", _badly_reloaded, (3.0, 5.0),
          after=(says("reload: refused"),)),
    Fault("disk-full", "no file of the service may grow (RLIMIT_FSIZE)", _disk_full,
          shows=(checkpoint_fails,), after=(checkpoint_written,)),
    Fault("log-reader-gone", "who reads the log goes away", _log_reader_gone,
          after=(says("thread MainThread"),)),
    Fault("log-reader-stuck", "who reads the log reads no more, and its pipe is full",
          _log_reader_stuck, (12.0, 15.0), after=(says(r"m2 \| tick"),)),
    Fault("viewer-stopped", "SIGSTOP to somebody who hears all that is published", _viewer_stopped,
          (10.0, 20.0)),
    Fault("request-flood", "hundreds of requests a second",
          _asked(lambda rng: _REQUESTS[rng.integers(len(_REQUESTS))]),
          after=(answers,)),
    Fault("request-garbage", "hundreds of broken requests a second", _asked(_nonsense),
          after=(answers,)),
    Fault("answer-flood", "hundreds of the controller's answers a second, and broken ones",
          _sent(lambda rng: (topics.GOAL_STATUS.key, _ANSWER),
                lambda rng: (topics.GOAL_STATUS.key, relay.broken(_ANSWER, rng)))),
)  # fmt: skip


def chosen(config: Config, names: Sequence[str] | None) -> list[Fault]:
    """The faults that there is a place for, or those of them that are named.

    Raises:
        UserError: there is no fault of that name, or no place for it.
    """
    there = {fault.name: fault for fault in FAULTS if fault.needs(config)}
    if names is None:
        return list(there.values())
    if unknown := [name for name in names if name not in there]:
        raise UserError(
            f"--faults: {unknown[0]!r:.40}: none of the faults for this configuration "
            f"(choices: {', '.join(there)})"
        )
    return [there[name] for name in dict.fromkeys(names)]


def table() -> str:
    """The table as docs/soak.md has it, in Markdown."""
    head = (
        "fault",
        "how it is made",
        "lasts, s",
        "shows meanwhile",
        "over within, s",
        "and then",
    )
    rows = [head, ("---",) * len(head), *map(_cells, FAULTS)]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _cells(fault: Fault) -> tuple[str, ...]:
    lasts = "–".join(f"{bound:g}" for bound in fault.lasts_s)
    shows, after = (
        "; ".join(str(hold.__doc__).rstrip(".") for hold in holds)
        for holds in (fault.shows, fault.after)
    )
    return f"`{fault.name}`", fault.what, lasts, shows, f"{fault.within_s:g}", after
