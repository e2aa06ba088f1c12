"""The table of faults: how to inject each, how long it lasts, what must hold."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from edge.bus import topics
from edge.config import Config
from edge.errors import UserError
from edge.lab.eval.soak import injectors, relay
from edge.lab.eval.soak.harness import BROKEN
from edge.lab.eval.soak.invariants import (
    Invariant,
    answers_requests,
    checkpoint_fails,
    checkpoint_written,
    log_has,
    page_answers,
    recording_fails,
    recording_goes_on,
    reports_no_view,
)

_IMAGES = (topics.RGB, topics.DEPTH, topics.SEGMENTATION, topics.CAMERA_INFO)
_JUMP_M, _JUMP_RAD = 15.0, 2.0
_CLOCK_ERROR_S = 3 * 3600.0


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
        during: each must hold at some time during the fault.
        after: must hold after the fault.
        log_pattern: pattern that a line of the log must match by then; "" for none. For two faults
            at the same time neither `during` nor `log_pattern` is checked, as one fault may hide
            the other.
        mutes: True if no published message can be received during the fault.
        needs: returns True if the fault is possible with a configuration.
    """

    name: str
    part: str
    what: str
    make: injectors.Injector
    lasts_s: tuple[float, float] = (5.0, 10.0)
    within_s: float = 15.0
    during: tuple[Invariant, ...] = ()
    after: tuple[Invariant, ...] = ()
    log_pattern: str = ""
    mutes: bool = False
    needs: Callable[[Config], bool] = lambda config: True


def _uses_router(config: Config) -> bool:
    return config.zenoh.mode == "client"


def _has_model_process(config: Config) -> bool:
    return config.perception.isolation == "process"


def _has_onnx_model(config: Config) -> bool:
    return config.perception.detector.kind == "onnx"


FAULTS: tuple[Fault, ...] = (
    Fault("camera-gone", "sensors", "the relay drops images",
          injectors.relay_alters(lambda rng: relay.nothing(_IMAGES)), during=(reports_no_view,)),
    Fault("odometry-gone", "sensors", "the relay drops odometry",
          injectors.relay_alters(lambda rng: relay.nothing((topics.ODOMETRY,))),
          during=(reports_no_view,)),
    Fault("simulator-stopped", "robot", "SIGSTOP to the simulator", injectors.simulator_stopped,
          during=(reports_no_view,)),
    Fault("session-cut", "bus", "the relay's session with the bus is closed and opened again",
          injectors.cut, during=(reports_no_view,)),
    Fault("next-house", "robot", "the simulator starts again in another house",
    injectors.next_house,
          within_s=40.0, log_pattern="pose jumped"),
    Fault("image-frozen", "sensors", "the same image again and again, with new stamps",
          injectors.relay_alters(lambda rng: relay.frozen(True))),
    Fault("driver-frozen", "sensors", "the same image again and again, with its old stamp",
          injectors.relay_alters(lambda rng: relay.frozen(False)), during=(reports_no_view,)),
    Fault("messages-late", "sensors", f"all sensor messages {injectors.LATE_S:g} s late",
    injectors.late),
    Fault("sensor-garbage", "sensors", "a malformed message before each sensor message",
          injectors.relay_alters(relay.garbage)),
    Fault("clock-ahead", "sensors", "sensor stamps three hours ahead",
          injectors.relay_alters(lambda rng: relay.other_clock(_CLOCK_ERROR_S))),
    Fault("clock-behind", "sensors", "sensor stamps three hours behind",
          injectors.relay_alters(lambda rng: relay.other_clock(-_CLOCK_ERROR_S))),
    Fault("pose-jump", "sensors",
          f"odometry jumps {_JUMP_M:g} m and {math.degrees(_JUMP_RAD):.0f}°, and back",
          injectors.relay_alters(lambda rng: relay.elsewhere(_JUMP_M, _JUMP_RAD)),
          during=(log_has("pose jumped"),)),
    Fault("router-killed", "bus", "kill -9 to the Zenoh router, then a restart",
          injectors.router_killed, (2.0, 5.0), 25.0, mutes=True, needs=_uses_router),
    Fault("controller-killed", "controller",
          "kill -9 to the motion controller, then a restart", injectors.controller_killed),
    Fault("model-killed", "model", "kill -9 to the model's process",
          injectors.model_signalled(signal.SIGKILL),
          (4.0, 6.0), 40.0, needs=_has_model_process, during=(log_has("ended by SIGKILL"),)),
    Fault("model-stopped", "model", "SIGSTOP to the model's process",
          injectors.model_signalled(signal.SIGSTOP),
          (8.0, 10.0), 40.0, needs=_has_model_process, during=(log_has("no answer within"),)),
    Fault("model-swapped", "model", "`edge models use --force` of a copy of the model",
          injectors.swapped, (1.0, 2.0), 90.0, log_pattern="model .*: kept", needs=_has_onnx_model),
    Fault("bad-model", "model", "`edge models use` of a damaged model", injectors.badly_swapped,
          (1.0, 2.0), 40.0, log_pattern=f"model {BROKEN}: refused", needs=_has_onnx_model),
    Fault("reload", "configuration", "SIGHUP with another `mission.verify_s`",
          injectors.reloaded({"mission": {"verify_s": 2.5}}, {}), (1.0, 2.0), 30.0,
          log_pattern="reload: switched"),
    Fault("policy-reload", "configuration", "SIGHUP with another policy",
          injectors.reloaded({"policy": {"kind": "nearest_frontier"}}, {}), (1.0, 2.0), 60.0,
          log_pattern="reload: switched"),
    Fault("bad-reload", "configuration", "SIGHUP with an invalid configuration",
          injectors.badly_reloaded, (3.0, 5.0), log_pattern="reload: refused"),
    Fault("disk-full", "disk", "no file of the service can grow (RLIMIT_FSIZE)",
    injectors.disk_full,
          during=(checkpoint_fails, recording_fails),
          after=(checkpoint_written, recording_goes_on)),
    Fault("log-reader-gone", "log", "the reader of the log exits", injectors.log_reader_gone,
          log_pattern="thread MainThread"),
    Fault("log-reader-stuck", "log", "the reader of the log stops reading, and the pipe is full",
          injectors.log_reader_stuck, (12.0, 15.0), log_pattern=r"m2 \| tick"),
    Fault("viewer-stopped", "viewer", "SIGSTOP to a subscriber of all topics",
          injectors.viewer_stopped, (10.0, 20.0)),
    Fault("page-open", "pages", "a browser has the live page open, with all its data",
          injectors.page_open, (10.0, 20.0), during=(page_answers,)),
    Fault("visitors-stuck", "pages",
          "dozens of HTTP connections a second that send incomplete requests",
          injectors.visitors_stuck, after=(page_answers,)),
    Fault("request-flood", "requests", "hundreds of requests a second",
          injectors.request_flood(
              lambda rng: injectors.REQUESTS[rng.integers(len(injectors.REQUESTS))]),
          after=(answers_requests,)),
    Fault("request-garbage", "requests", "hundreds of malformed requests a second",
          injectors.request_flood(injectors.nonsense), after=(answers_requests,)),
    Fault("answer-flood", "controller",
          "hundreds of goal statuses a second, valid and malformed",
          injectors.message_flood(lambda rng: (topics.GOAL_STATUS.key, injectors.ANSWER),
                lambda rng: (topics.GOAL_STATUS.key, relay.broken(injectors.ANSWER, rng)))),
)  # fmt: skip


def chosen(config: Config, names: Sequence[str] | None) -> list[Fault]:
    """Return the faults that are possible with a configuration, or the named ones of them.

    Raises:
        UserError: a named fault does not exist, or is not possible.
    """
    possible = {fault.name: fault for fault in FAULTS if fault.needs(config)}
    if names is None:
        return list(possible.values())
    if unknown := [name for name in names if name not in possible]:
        raise UserError(
            f"--faults: no fault {unknown[0]!r:.40} with this configuration (choices: "
            f"{', '.join(possible)})"
        )
    return [possible[name] for name in dict.fromkeys(names)]
