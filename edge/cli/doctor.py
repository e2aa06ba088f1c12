"""`edge doctor`: checks this machine, and reports what to do about each problem.

Each check is a function that takes the configuration and yields findings; `CHECKS` lists them. A
finding is `fail` if the configuration cannot run without it, and `warn` for any other problem.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict
from importlib import util

from edge.cli import bus_checks, machine_checks, model_checks, preflight
from edge.cli.findings import Check, Finding, Level, fail, finding_of, ok
from edge.cli.live_checks import check_live_sensors
from edge.cli.onnx_probe import crashes
from edge.config import Config, load
from edge.errors import UserError
from edge.host import resources
from edge.text import one_line


def run(args: argparse.Namespace) -> int:
    """Handle `edge doctor`; return 1 if a finding is `fail`.

    With `--live`, return 1 also for `warn`.

    Raises:
        ConfigError: the configuration cannot be read.
    """
    config = load(args.config)
    findings = check_live_sensors(config, args.seconds) if args.live else examine(config)
    print(as_json(findings) if args.json else as_text(findings))
    bad = ("warn", "fail") if args.live else ("fail",)
    return 1 if any(finding.level in bad for finding in findings) else 0


def examine(config: Config) -> list[Finding]:
    """Return all findings, in the order of `CHECKS`. A check that raises becomes a `fail`."""
    findings = []
    for check in CHECKS:
        try:
            findings += check(config)
        except UserError as error:
            findings.append(finding_of(error))
        except Exception as error:
            name = check.__name__.removeprefix("check_").replace("_", " ")
            reason = one_line(f"{type(error).__name__}: {error}")
            todo = "please report this bug of edge"
            findings.append(fail(f"check of {name} crashed: {reason}", todo))
    # Several checks may find the same problem; one of them may know what to do.
    return list({(f.level, f.what): f for f in findings}.values())


def as_text(findings: list[Finding]) -> str:
    """Return one line `level  what — todo` for each finding, and a summary."""
    lines = [f"{f.level:4}  {f.what}" + (f" — {f.todo}" if f.todo else "") for f in findings]
    counts = {level: sum(f.level == level for f in findings) for level in ("ok", "warn", "fail")}
    lines.append(", ".join(f"{n} {level}" for level, n in counts.items()))
    return "\n".join(lines)


def as_json(findings: list[Finding]) -> str:
    """Return the findings as JSON: `{"ok": bool, "findings": [{"level", "what", "todo"}]}`."""
    healthy = all(finding.level != "fail" for finding in findings)
    return json.dumps({"ok": healthy, "findings": [asdict(f) for f in findings]}, indent=2)


def check_configuration(config: Config) -> Iterator[Finding]:
    """Check all that `edge run` checks before it starts; see `edge.cli.preflight`."""
    try:
        preflight.check(config, use_onnxruntime=not crashes())
    except UserError as error:
        for line in str(error).splitlines():
            yield finding_of(UserError(line), todo="correct the configuration")


def check_mission(config: Config) -> Iterator[Finding]:
    """Check that the mission is understood and possible, and the checkpoint can be written.

    Also check that the detector knows the targets.
    """
    from edge.host.checkpoint import CheckpointWriter
    from edge.mission.checkpoint import MISSION
    from edge.tasks.mission_spec import prepare_mission

    try:
        spec = prepare_mission(config)
        if not crashes():
            preflight.check_mission(config)
        if config.mission.checkpoint is not None:
            CheckpointWriter(resources.expand(config.mission.checkpoint), MISSION).close()
    except UserError as error:
        yield finding_of(error, todo="see `edge mission explain`")
    else:
        translation = spec.translation
        formula = f" [{one_line(translation.formula)}]" if spec.steps is None else ""
        yield ok(f"mission: {translation.understood}{formula}")


def check_worlds(config: Config) -> Iterator[Finding]:
    """Check the packages for simulated worlds with textures."""
    wanted = ("trimesh", "PIL", "embreex")
    missing = [name for name in wanted if util.find_spec(name) is None]
    if not missing:
        yield ok("textured worlds: trimesh, pillow and embreex are installed")
        return
    level_if_missing: Level = "fail" if config.sim.world.kind == "mesh" else "warn"
    what = f"textured worlds cannot be simulated: not installed: {', '.join(missing)}"
    todo = "pip install 'edge-vln[worlds]' (embreex: x86_64 only)"
    yield Finding(level_if_missing, what, todo)


CHECKS: tuple[Check, ...] = (
    machine_checks.check_python, machine_checks.check_packages, machine_checks.check_opencv,
    machine_checks.check_cores, machine_checks.check_speed, machine_checks.check_jetson,
    machine_checks.check_shared_memory, machine_checks.check_cache, machine_checks.check_stop,
    machine_checks.check_numba, bus_checks.check_zenoh, bus_checks.check_endpoint,
    bus_checks.check_access, model_checks.check_onnxruntime, model_checks.check_tensorrt,
    check_configuration, model_checks.check_models, check_mission, model_checks.check_background,
    model_checks.check_choice_server, check_worlds,
)  # fmt: skip
