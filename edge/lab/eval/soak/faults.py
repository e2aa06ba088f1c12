"""The table of faults: how to inject each, how long it lasts, what must hold."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from edge.bus import topics
from edge.config import Config
from edge.errors import UserError
from edge.lab.eval.soak import made, relay
from edge.lab.eval.soak.holds import (
    Hold,
    answers,
    blind,
    checkpoint_fails,
    checkpoint_written,
    page_answers,
    recording_fails,
    recording_goes_on,
    says,
)
from edge.lab.eval.soak.stage import BROKEN

_IMAGES = (topics.RGB, topics.DEPTH, topics.SEGMENTATION, topics.CAMERA_INFO)
_JUMP_M, _JUMP_RAD = 15.0, 2.0
_CLOCK_S = 3 * 3600.0


@dataclass(frozen=True)
class Fault:
    """A row of the table.

    Attributes:
        name: for `--faults`.
        part: the affected part. Two faults at the same time affect two parts.
        what: description for the log.
        make: injects the fault.
        lasts_s: shortest and longest duration.
        within_s: time after the end within which `recovered` and all of `after` must hold together.
        shows: each must hold at some time during the fault.
        after: must hold after the fault.
        says: pattern that the log must have by then. For two faults at the same time neither
            `shows` nor `says` is checked, as one fault may hide the other.
        mutes: no published message can be received during the fault.
        needs: returns True if the fault is possible with a configuration.
    """

    name: str
    part: str
    what: str
    make: made.Make
    lasts_s: tuple[float, float] = (5.0, 10.0)
    within_s: float = 15.0
    shows: tuple[Hold, ...] = ()
    after: tuple[Hold, ...] = ()
    says: str = ""
    mutes: bool = False
    needs: Callable[[Config], bool] = lambda config: True


def _router(config: Config) -> bool:
    return config.zenoh.mode == "client"


def _process(config: Config) -> bool:
    return config.perception.isolation == "process"


def _onnx(config: Config) -> bool:
    return config.perception.detector.kind == "onnx"


FAULTS: tuple[Fault, ...] = (
    Fault("camera-gone", "sensors", "the relay drops images",
          made.altered(lambda rng: relay.nothing(_IMAGES)), shows=(blind,)),
    Fault("odometry-gone", "sensors", "the relay drops odometry",
          made.altered(lambda rng: relay.nothing((topics.ODOMETRY,))), shows=(blind,)),
    Fault("simulator-stopped", "robot", "SIGSTOP to the simulator", made.simulator_stopped,
          shows=(blind,)),
    Fault("session-cut", "bus", "the relay's session with the bus is closed and opened again",
          made.cut, shows=(blind,)),
    Fault("next-house", "robot", "the simulator starts again in another house", made.next_house,
          within_s=40.0, says="pose jumped"),
    Fault("image-frozen", "sensors", "the same image again and again, with new stamps",
          made.altered(lambda rng: relay.frozen(True))),
    Fault("driver-frozen", "sensors", "the same image again and again, with its old stamp",
          made.altered(lambda rng: relay.frozen(False)), shows=(blind,)),
    Fault("messages-late", "sensors", f"all sensor messages {made.LATE_S:g} s late", made.late),
    Fault("sensor-garbage", "sensors", "a malformed message before each sensor message",
          made.altered(relay.garbage)),
    Fault("clock-ahead", "sensors", "sensor stamps three hours ahead",
          made.altered(lambda rng: relay.other_clock(_CLOCK_S))),
    Fault("clock-behind", "sensors", "sensor stamps three hours behind",
          made.altered(lambda rng: relay.other_clock(-_CLOCK_S))),
    Fault("pose-jump", "sensors",
          f"odometry jumps {_JUMP_M:g} m and {math.degrees(_JUMP_RAD):.0f}°, and back",
          made.altered(lambda rng: relay.elsewhere(_JUMP_M, _JUMP_RAD)),
          shows=(says("pose jumped"),)),
    Fault("router-killed", "bus", "kill -9 to the Zenoh router, then a restart",
          made.router_killed, (2.0, 5.0), 25.0, mutes=True, needs=_router),
    Fault("controller-killed", "controller",
          "kill -9 to the motion controller, then a restart", made.controller_killed),
    Fault("model-killed", "model", "kill -9 to the model's process",
          made.model_signalled(signal.SIGKILL),
          (4.0, 6.0), 40.0, needs=_process, shows=(says("ended by SIGKILL"),)),
    Fault("model-stopped", "model", "SIGSTOP to the model's process",
          made.model_signalled(signal.SIGSTOP),
          (8.0, 10.0), 40.0, needs=_process, shows=(says("no answer within"),)),
    Fault("model-swapped", "model", "`edge models use --force` of a copy of the model",
          made.swapped, (1.0, 2.0), 90.0, says="model .*: kept", needs=_onnx),
    Fault("bad-model", "model", "`edge models use` of a damaged model", made.badly_swapped,
          (1.0, 2.0), 40.0, says=f"model {BROKEN}: refused", needs=_onnx),
    Fault("reload", "configuration", "SIGHUP with another `mission.verify_s`",
          made.reloaded({"mission": {"verify_s": 2.5}}, {}), (1.0, 2.0), 30.0,
          says="reload: switched"),
    Fault("policy-reload", "configuration", "SIGHUP with another policy",
          made.reloaded({"policy": {"kind": "nearest_frontier"}}, {}), (1.0, 2.0), 60.0,
          says="reload: switched"),
    Fault("bad-reload", "configuration", "SIGHUP with an invalid configuration",
          made.badly_reloaded, (3.0, 5.0), says="reload: refused"),
    Fault("disk-full", "disk", "no file of the service can grow (RLIMIT_FSIZE)", made.disk_full,
          shows=(checkpoint_fails, recording_fails),
          after=(checkpoint_written, recording_goes_on)),
    Fault("log-reader-gone", "log", "the reader of the log exits", made.log_reader_gone,
          says="thread MainThread"),
    Fault("log-reader-stuck", "log", "the reader of the log stops reading, and the pipe is full",
          made.log_reader_stuck, (12.0, 15.0), says=r"m2 \| tick"),
    Fault("viewer-stopped", "viewer", "SIGSTOP to a subscriber of all topics",
          made.viewer_stopped, (10.0, 20.0)),
    Fault("page-open", "pages", "a browser has the live page open, with all its data",
          made.page_open, (10.0, 20.0), shows=(page_answers,)),
    Fault("visitors-stuck", "pages",
          "dozens of HTTP connections a second that send incomplete requests",
          made.visitors_stuck, after=(page_answers,)),
    Fault("request-flood", "requests", "hundreds of requests a second",
          made.asked(lambda rng: made.REQUESTS[rng.integers(len(made.REQUESTS))]),
          after=(answers,)),
    Fault("request-garbage", "requests", "hundreds of malformed requests a second",
          made.asked(made.nonsense), after=(answers,)),
    Fault("answer-flood", "controller",
          "hundreds of goal statuses a second, valid and malformed",
          made.sent(lambda rng: (topics.GOAL_STATUS.key, made.ANSWER),
                lambda rng: (topics.GOAL_STATUS.key, relay.broken(made.ANSWER, rng)))),
)  # fmt: skip


def chosen(config: Config, names: Sequence[str] | None) -> list[Fault]:
    """Return the faults that are possible with a configuration, or the named ones of them.

    Raises:
        UserError: a named fault does not exist, or is not possible.
    """
    there = {fault.name: fault for fault in FAULTS if fault.needs(config)}
    if names is None:
        return list(there.values())
    if unknown := [name for name in names if name not in there]:
        raise UserError(
            f"--faults: {unknown[0]!r:.40}: not a fault for this configuration "
            f"(choices: {', '.join(there)})"
        )
    return [there[name] for name in dict.fromkeys(names)]
