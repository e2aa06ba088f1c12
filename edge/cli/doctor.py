"""`edge doctor`: checks this machine, and reports what to do about each problem.

Each check is a function that takes the configuration and yields findings; `CHECKS` lists them. A
finding is `fail` if the configuration cannot run without it, and `warn` for any other problem.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import time
from collections.abc import Iterator
from dataclasses import asdict
from importlib import metadata, util
from pathlib import Path
from urllib.parse import urlsplit

from edge.cli.live_checks import check_live_sensors
from edge.cli.machine_checks import (
    Check,
    Finding,
    Level,
    check_cache,
    check_cores,
    check_jetson,
    check_numba,
    check_opencv,
    check_packages,
    check_python,
    check_shared_memory,
    check_speed,
    check_stop,
)
from edge.cli.onnx_probe import CPU, probe
from edge.cli.preflight import CLASSES, named_models
from edge.config import Config, load
from edge.errors import UserError
from edge.host import resources
from edge.perception.runtime import cuda, tensorrt
from edge.perception.runtime.card_types import ChoiceCard, FileCard
from edge.perception.runtime.sessions import TENSORRT
from edge.text import one_line, redact

LOOPBACK_S = 5.0
"""Time for a message from Zenoh to Zenoh on this machine."""
SERVER_S = 2.0
"""Time for the connection to a server."""


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
            findings.append(Finding("fail", *_split(error)))
        except Exception as error:
            name = check.__name__.removeprefix("check_").replace("_", " ")
            reason = one_line(f"{type(error).__name__}: {error}")
            findings.append(
                Finding(
                    "fail", f"check of {name} crashed: {reason}", "please report this bug of edge"
                )
            )
    return list(dict.fromkeys(findings))  # several checks may find the same problem


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


# -- the bus and its access -------------------------------------------------------------------


def check_zenoh(config: Config) -> Iterator[Finding]:
    """Check that Zenoh can send a message on this machine."""
    version = metadata.version("eclipse-zenoh")
    took_ms = loopback_ms(LOOPBACK_S)
    if took_ms is not None:
        yield Finding(
            "ok", f"Zenoh {version}: a test message over TCP on 127.0.0.1 took {took_ms:.0f} ms"
        )
    else:
        todo = "allow TCP on 127.0.0.1: check sandbox and firewall, run `ip link set lo up`"
        yield Finding(
            "fail",
            f"Zenoh {version}: no test message over TCP on 127.0.0.1 came within {LOOPBACK_S:g} s",
            todo,
        )


def loopback_ms(limit_s: float) -> float | None:
    """Send one message from a connecting to a listening Zenoh session over TCP on 127.0.0.1.

    Returns:
        The time from opening the sessions to the message, in ms; None: no message came.
    """
    import zenoh

    from edge.bus.session import open_session
    from edge.config import ZenohConfig
    from edge.host.ports import free_port

    before = time.perf_counter()
    settings = ZenohConfig(endpoint=f"tcp/127.0.0.1:{free_port()}")
    key = f"edge-doctor/{os.getpid()}"
    with open_session(settings, "listen") as receiver, open_session(settings, "connect") as sender:
        subscriber = receiver.declare_subscriber(key, zenoh.handlers.RingChannel(4))
        while time.perf_counter() - before < limit_s:
            sender.put(key, b"hello")  # repeated, until the subscription has reached the sender
            if subscriber.try_recv() is not None:
                return 1e3 * (time.perf_counter() - before)
            time.sleep(0.01)
    return None


def check_endpoint(config: Config) -> Iterator[Finding]:
    """Check that the service can listen at `zenoh.endpoint`."""
    from edge.bus.session import BusError, open_session

    if config.zenoh.mode == "client":
        yield Finding(
            "ok",
            f"the service will connect to a Zenoh router at {config.zenoh.address} (not tried)",
        )
        return
    try:
        open_session(config.zenoh, "listen").close()
    except BusError as error:
        yield Finding(
            "warn",
            f"the service cannot listen at {config.zenoh.address} (zenoh.endpoint)",
            str(error),
        )
    else:
        yield Finding("ok", f"the service can listen at {config.zenoh.address}")


def check_access(config: Config) -> Iterator[Finding]:
    """Check who can connect to the service, and who can read the files with secrets."""
    from edge.bus.session import DENIED_WARNING, OPEN_WARNING, session_config, zenoh_file_of
    from edge.bus.zenoh_file import denies_prefix, exposed_secrets, open_addresses
    from edge.host.credentials import is_open_to_others, read_token

    settings, http = config.zenoh, config.http
    served = session_config(settings, "listen")
    for address in open_addresses(served):
        todo = "listen on 127.0.0.1, or require certificates (docs/security.md)"
        yield Finding("warn", OPEN_WARNING.format(address), todo)
    if denies_prefix(served, settings.prefix):
        todo = "correct the keys under access_control in zenoh.file (docs/security.md)"
        yield Finding("warn", DENIED_WARNING.format(settings.prefix), todo)
    paths = [
        path
        for role in ("listen", "connect")
        for path in exposed_secrets(session_config(settings, role), *zenoh_file_of(settings, role))
    ]
    if http.token_file is not None:
        read_token("http.token_file", http.token_file)
        if is_open_to_others(resources.expand(http.token_file)):
            paths.append(http.token_file)
    for path in dict.fromkeys(paths):
        what = f"{path} holds a secret, but every user of this machine can read or write it"
        yield Finding("warn", what, f"chmod o= {path}")


# -- the detector -----------------------------------------------------------------------------


def _is_installed(package: str) -> bool:
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        return False
    return True


def check_onnxruntime(config: Config) -> Iterator[Finding]:
    """Check that onnxruntime works and has the configured execution providers."""
    detector = config.perception.detector
    wanted = detector.providers if detector.kind == "onnx" else ()
    needed = any(name != TENSORRT for name in wanted)
    level_if_missing: Level = "fail" if needed else "warn"
    if _is_installed("onnxruntime") and _is_installed("onnxruntime-gpu"):
        todo = "pip uninstall onnxruntime onnxruntime-gpu, then install only one of them"
        yield Finding("warn", "onnxruntime and onnxruntime-gpu are both installed", todo)
    probed = probe()
    if probed is None:
        todo = "pip install 'edge-vln[cpu]' (or [gpu])"
        yield Finding(
            level_if_missing, "onnxruntime is not installed, so no neural detector can run", todo
        )
        return
    what = f"onnxruntime {probed.version}".strip()
    if not probed.fault:
        names = ", ".join(name.removesuffix("ExecutionProvider") for name in probed.providers)
        yield Finding("ok", f"{what} runs a model; execution providers: {names}")
    elif CPU in probed.ran:  # so the fault is in another provider
        yield Finding(
            "warn",
            f"{what} {probed.fault}",
            "check the GPU driver and CUDA, or use CPUExecutionProvider",
        )
    else:
        todo = (
            "another version may work (pip install 'onnxruntime==1.20.1'), and on arm64 all cores "
            "must be on (Jetson: sudo nvpmodel -m 0; not under qemu): docs/install.md"
        )
        yield Finding(level_if_missing, f"{what} {probed.fault}", todo)
        return
    for name in wanted:
        if name != TENSORRT and name not in probed.providers:
            todo = (
                "install an onnxruntime with this provider, or change perception.detector.providers"
            )
            yield Finding(
                "fail",
                f"perception.detector.providers: {name} is not in the installed onnxruntime",
                todo,
            )


def _sessions_crash() -> bool:
    """Return True if onnxruntime is installed but fails, as `check_onnxruntime` reports.

    Then no check may open a session in this process.
    """
    probed = probe()
    return probed is not None and CPU not in probed.ran


def check_tensorrt(config: Config) -> Iterator[Finding]:
    """Check that TensorRT works, if the detector uses it."""
    detector = config.perception.detector
    if detector.kind != "onnx" or TENSORRT not in detector.providers:
        return
    try:
        version = tensorrt.load().__version__
        cuda.Device(detector.device_id)
    except UserError as error:
        yield Finding("fail", *_split(error))
    else:
        yield Finding("ok", f"TensorRT {version}, on GPU {detector.device_id}")


def _split(error: Exception) -> tuple[str, str]:
    """Split the message of an error at `; ` into the problem and what to do."""
    what, _, todo = str(error).partition("; ")
    return what, todo


def check_classes(config: Config) -> Iterator[Finding]:
    """Check the classes of source, sinks, policy and planner, and their options."""
    for check in CLASSES:
        try:
            check(config)
        except UserError as error:
            what, todo = _split(error)
            yield Finding("fail", what, todo or "correct the configuration")


def check_models(config: Config) -> Iterator[Finding]:
    """Check the files of all models that are here or that the configuration names."""
    from edge.perception.runtime.cards import ModelError, card_names, check_installed, load_card

    needed = {model.name for model in named_models(config)}
    names = sorted({*card_names(), *needed})
    if not names:
        yield Finding(
            "warn", "no model cards: the package's folder models/ is missing", "reinstall edge-vln"
        )
    n_absent = 0
    for name in names:
        try:
            card = load_card(name)
            served = [file.server for file in card.files if file.server is not None]
            try:
                check_installed(card)
            except ModelError:
                if name in needed:
                    raise
                n_absent += 1
                continue
            paths = [_verify(file) for file in card.files if file.server is None]
        except ModelError as error:
            yield Finding("fail" if name in needed else "warn", *_split(error))
        else:
            yield from (Finding("ok", f"model {name}: {path}") for path in paths)
            yield from (_server_finding(name, server.url) for server in served)
    if n_absent:
        what = (
            f"{n_absent} other models are not on this machine, and this configuration needs none "
            "of them"
        )
        yield Finding("ok", f"{what} (`edge models list`)")


def _verify(file: FileCard | ChoiceCard) -> Path:
    """Check the hash of a model file, and return its path."""
    from edge.perception.runtime.cards import verify_model, verify_parts

    if not isinstance(file, ChoiceCard):
        return verify_model(file)
    verify_parts(file)
    return file.path


def _server_finding(name: str, url: str) -> Finding:
    """Return the finding on the server of a model that does not run on this machine."""
    shown = redact(url)
    if _listens(url):
        return Finding("ok", f"model {name}: a server listens at {shown}")
    todo = "start the server, or correct its URL in the model card"
    return Finding("warn", f"model {name}: no server listens at {shown}", todo)


def check_mission(config: Config) -> Iterator[Finding]:
    """Check that the mission is understood and possible, and the checkpoint can be written."""
    from edge.host.checkpoint import CheckpointWriter
    from edge.mission.checkpoint import MISSION
    from edge.mission.spec import prepare

    try:
        spec = prepare(config.mission)
        if config.mission.checkpoint is not None:
            CheckpointWriter(resources.expand(config.mission.checkpoint), MISSION).close()
    except UserError as error:
        what, todo = _split(error)
        yield Finding("fail", what, todo or "see `edge mission explain`")
    else:
        translation = spec.translation
        yield Finding("ok", f"mission: {translation.understood} [{one_line(translation.formula)}]")


def _targets(config: Config) -> tuple[str, ...]:
    """Return the targets of the mission; of a refused mission only `mission.target`."""
    from edge.mission.spec import prepare

    try:
        return prepare(config.mission).prompts
    except UserError:
        return (config.mission.target,)


def check_vocabulary(config: Config) -> Iterator[Finding]:
    """Check that the detector's text encoder knows the targets and the background words."""
    from edge.perception.embedding.encoders import make_text_encoder
    from edge.perception.embedding.text import TextEmbeddings, TextEncoder, words_for
    from edge.perception.runtime.cards import load_detector_card

    detector = config.perception.detector
    if detector.kind == "onnx" and _sessions_crash():
        return
    encoder: TextEncoder
    try:
        if detector.kind == "onnx":
            encoder = make_text_encoder(load_detector_card(detector.model), detector.vocabulary)
            encoder.embed(_targets(config))
        else:
            encoder = TextEmbeddings(None)
    except UserError as error:
        yield Finding("fail" if detector.kind == "onnx" else "warn", *_split(error))
    else:
        yield Finding("ok", f"text embeddings: {encoder!r}")
        if detector.kind == "onnx":
            known = words_for(detector.background, encoder.resolve)
            unknown = [word for word in detector.background if word not in known]
            if unknown:
                what = (
                    f"model {detector.model} does not know {len(unknown)} of the "
                    f"{len(detector.background)} words of perception.detector.background"
                )
                yield Finding("warn", what, f"remove or replace these words: {', '.join(unknown)}")


def check_scorers(config: Config) -> Iterator[Finding]:
    """Check that the configured scorers can be made, and that their server listens."""
    from edge.loop.scorers import make_scorers

    uses_onnx = config.perception.similarity is not None or config.perception.choice.kind == "onnx"
    if uses_onnx and _sessions_crash():
        return
    try:
        scorers = make_scorers(config, _targets(config))
    except UserError as error:
        yield Finding("fail", *_split(error))
        return
    if scorers is None:
        return
    names = scorers.names()
    scorers.close()
    yield Finding("ok", f"scorers: {', '.join(names)}")
    choice = config.perception.choice
    if choice.kind in ("openai", "text") and not _listens(choice.url):
        todo = "start the server, or correct the URL; until then no model chooses among frontiers"
        yield Finding(
            "warn", f"perception.choice.url: no server listens at {redact(choice.url)}", todo
        )


def _listens(url: str) -> bool:
    """Return True if a TCP connection to the server of a URL can be opened."""
    parts = urlsplit(url)
    port = parts.port or {"http": 80, "https": 443}[parts.scheme]
    try:
        socket.create_connection((parts.hostname, port), SERVER_S).close()
    except (OSError, UnicodeError):  # UnicodeError: an invalid label in the host name
        return False
    return True


def check_tasks(config: Config) -> Iterator[Finding]:
    """Check the interpreter for scripts of a model, which `tasks.planner: rules` does not need."""
    from edge.tasks import script

    try:
        version = script.version()
    except UserError as error:
        level_if_missing: Level = "fail" if config.tasks.planner.kind == "model" else "warn"
        yield Finding(level_if_missing, *_split(error))
    else:
        yield Finding(
            "ok",
            f"tasks: pydantic-monty {version} can run the scripts that a language model writes",
        )


def check_worlds(config: Config) -> Iterator[Finding]:
    """Check the packages for simulated worlds with textures."""
    wanted = ("trimesh", "PIL", "embreex")
    missing = [name for name in wanted if util.find_spec(name) is None]
    if not missing:
        yield Finding("ok", "textured worlds: trimesh, pillow and embreex are installed")
        return
    level_if_missing: Level = "fail" if config.sim.world.kind == "mesh" else "warn"
    todo = "pip install 'edge-vln[worlds]' (embreex: x86_64 only)"
    yield Finding(
        level_if_missing,
        f"textured worlds cannot be simulated: not installed: {', '.join(missing)}",
        todo,
    )


CHECKS: tuple[Check, ...] = (
    check_python,
    check_packages,
    check_opencv,
    check_cores,
    check_speed,
    check_jetson,
    check_shared_memory,
    check_cache,
    check_stop,
    check_numba,
    check_zenoh,
    check_endpoint,
    check_access,
    check_onnxruntime,
    check_tensorrt,
    check_classes,
    check_models,
    check_mission,
    check_vocabulary,
    check_scorers,
    check_tasks,
    check_worlds,
)
