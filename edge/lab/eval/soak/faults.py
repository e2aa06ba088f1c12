"""The table of the faults of `edge soak`: how to inject each, how long it lasts, what must hold."""

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
    check_checkpoint_failure,
    check_checkpoint_written,
    check_no_view_reported,
    check_page,
    check_recording_continues,
    check_recording_failure,
    check_requests,
    log_check,
)

_IMAGES = (topics.RGB, topics.DEPTH, topics.SEGMENTATION, topics.CAMERA_INFO)
_JUMP_M, _JUMP_RAD = 15.0, 2.0  # jump of the odometry: distance and turn
_CLOCK_ERROR_S = 3 * 3600.0


@dataclass(frozen=True)
class Fault:
    """A fault to inject: a row of `FAULTS`.

    Attributes:
        name: its name for `--faults`.
        part: the affected part. Two faults at the same time affect two parts.
        what: description for the log.
        lasts_s: shortest and longest duration; a duration between them is drawn.
        within_s: time after the end within which `check_recovered` and all of `after` must hold
            together.
        during: conditions; each must hold at some time during the fault.
        after: conditions that must hold after the fault.
        log_pattern: pattern that a line of the log must match after the fault; "" for none. For
            two faults at the same time neither `during` nor `log_pattern` is checked, as one fault
            may hide the other.
        mutes_bus: True if no published message can be received during the fault.
        needs: returns True if the fault is possible with a configuration.
    """

    name: str
    part: str
    what: str
    inject: injectors.Injector
    lasts_s: tuple[float, float] = (5.0, 10.0)
    within_s: float = 15.0
    during: tuple[Invariant, ...] = ()
    after: tuple[Invariant, ...] = ()
    log_pattern: str = ""
    mutes_bus: bool = False
    needs: Callable[[Config], bool] = lambda config: True


def _uses_router(config: Config) -> bool:
    return config.zenoh.mode == "client"


def _has_model_process(config: Config) -> bool:
    return config.perception.isolation == "process"


def _has_onnx_model(config: Config) -> bool:
    return config.perception.detector.kind == "onnx"


FAULTS: tuple[Fault, ...] = (
    Fault("camera-gone", "sensors", "the relay drops images",
          injectors.alter_messages(lambda rng: relay.drop(_IMAGES)),
          during=(check_no_view_reported,)),
    Fault("odometry-gone", "sensors", "the relay drops odometry",
          injectors.alter_messages(lambda rng: relay.drop((topics.ODOMETRY,))),
          during=(check_no_view_reported,)),
    Fault("simulator-stopped", "robot", "SIGSTOP to the simulator", injectors.STOP_SIMULATOR,
          during=(check_no_view_reported,)),
    Fault("session-cut", "bus", "the relay's session with the bus is closed and opened again",
          injectors.CUT_SESSION, during=(check_no_view_reported,)),
    Fault("next-house", "robot", "the simulator starts again in another house",
          injectors.ENTER_NEXT_HOUSE,
          within_s=40.0, log_pattern="pose jumped"),
    Fault("image-frozen", "sensors", "the same image again and again, with new stamps",
          injectors.alter_messages(lambda rng: relay.freeze(True))),
    Fault("driver-frozen", "sensors", "the same image again and again, with its old stamp",
          injectors.alter_messages(lambda rng: relay.freeze(False)),
          during=(check_no_view_reported,)),
    Fault("messages-late", "sensors", f"all sensor messages {injectors.LATE_S:g} s late",
          injectors.DELAY_MESSAGES),
    Fault("sensor-garbage", "sensors", "a malformed message before each sensor message",
          injectors.alter_messages(relay.add_garbage)),
    Fault("clock-ahead", "sensors", "sensor stamps three hours ahead",
          injectors.alter_messages(lambda rng: relay.shift_stamps(_CLOCK_ERROR_S))),
    Fault("clock-behind", "sensors", "sensor stamps three hours behind",
          injectors.alter_messages(lambda rng: relay.shift_stamps(-_CLOCK_ERROR_S))),
    Fault("pose-jump", "sensors",
          f"odometry jumps {_JUMP_M:g} m and {math.degrees(_JUMP_RAD):.0f}°, and back",
          injectors.alter_messages(lambda rng: relay.move_odometry(_JUMP_M, _JUMP_RAD)),
          during=(log_check("pose jumped"),)),
    Fault("router-killed", "bus", "kill -9 to the Zenoh router, then a restart",
          injectors.KILL_ROUTER, (2.0, 5.0), 25.0, mutes_bus=True, needs=_uses_router),
    Fault("controller-killed", "controller",
          "kill -9 to the motion controller, then a restart", injectors.KILL_CONTROLLER),
    Fault("model-killed", "model", "kill -9 to the model's process",
          injectors.signal_model(signal.SIGKILL),
          (4.0, 6.0), 40.0, needs=_has_model_process, during=(log_check("ended by SIGKILL"),)),
    Fault("model-stopped", "model", "SIGSTOP to the model's process",
          injectors.signal_model(signal.SIGSTOP),
          (8.0, 10.0), 40.0, needs=_has_model_process, during=(log_check("no answer within"),)),
    Fault("model-swapped", "model", "`edge models use --force` of a copy of the model",
          injectors.SWAP_MODEL, (1.0, 2.0), 90.0, log_pattern="model .*: kept",
          needs=_has_onnx_model),
    Fault("bad-model", "model", "`edge models use` of a damaged model", injectors.SWAP_TO_BAD_MODEL,
          (1.0, 2.0), 40.0, log_pattern=f"model {BROKEN}: refused", needs=_has_onnx_model),
    Fault("reload", "configuration", "SIGHUP with another `mission.verify_s`",
          injectors.reload_changed_config({"mission": {"verify_s": 2.5}}, {}), (1.0, 2.0), 30.0,
          log_pattern="reload: switched"),
    Fault("policy-reload", "configuration", "SIGHUP with another policy",
          injectors.reload_changed_config({"policy": {"kind": "nearest_frontier"}}, {}),
          (1.0, 2.0), 60.0,
          log_pattern="reload: switched"),
    Fault("bad-reload", "configuration", "SIGHUP with an invalid configuration",
          injectors.reload_bad_config, (3.0, 5.0), log_pattern="reload: refused"),
    Fault("disk-full", "disk", "no file of the service can grow (RLIMIT_FSIZE)",
          injectors.fill_disk,
          during=(check_checkpoint_failure, check_recording_failure),
          after=(check_checkpoint_written, check_recording_continues)),
    Fault("log-reader-gone", "log", "the reader of the log exits", injectors.CLOSE_LOG_READER,
          log_pattern="thread MainThread"),
    Fault("log-reader-stuck", "log", "the reader of the log stops reading, and the pipe is full",
          injectors.BLOCK_LOG_READER, (12.0, 15.0), log_pattern=r"m2 \| tick"),
    Fault("viewer-stopped", "viewer", "SIGSTOP to a subscriber of all topics",
          injectors.stop_viewer, (10.0, 20.0)),
    Fault("page-open", "pages", "a browser has the live page open, with all its data",
          injectors.read_live_page, (10.0, 20.0), during=(check_page,)),
    Fault("visitors-stuck", "pages",
          "dozens of HTTP connections a second that send incomplete requests",
          injectors.send_incomplete_requests, after=(check_page,)),
    Fault("request-flood", "requests", "hundreds of requests a second",
          injectors.flood_requests(
              lambda rng: injectors.REQUESTS[rng.integers(len(injectors.REQUESTS))]),
          after=(check_requests,)),
    Fault("request-garbage", "requests", "hundreds of malformed requests a second",
          injectors.flood_requests(injectors.malformed_request), after=(check_requests,)),
    Fault("answer-flood", "controller",
          "hundreds of goal statuses a second, valid and malformed",
          injectors.flood_messages(lambda rng: (topics.GOAL_STATUS.key, injectors.ANSWER),
                lambda rng: (topics.GOAL_STATUS.key, relay.malformed(injectors.ANSWER, rng)))),
)  # fmt: skip


def choose_faults(config: Config, names: Sequence[str] | None) -> list[Fault]:
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
