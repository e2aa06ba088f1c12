"""Checks of `edge doctor` for neural models: their runtimes, files, words and servers."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import urlsplit

from edge.cli.findings import Finding, Level, fail, finding_of, ok, warn
from edge.cli.machine_checks import is_installed
from edge.cli.onnx_probe import CPU, CUDA, crashes, fault_of
from edge.cli.preflight import named_models
from edge.config import Config
from edge.errors import UserError
from edge.perception.runtime import cuda, tensorrt
from edge.perception.runtime.card_types import ChoiceCard, FileCard
from edge.perception.runtime.sessions import TENSORRT
from edge.text import redact

DISTRIBUTIONS = ("onnxruntime", "onnxruntime-gpu")
"""Packages that contain onnxruntime."""
SERVER_S = 2.0
"""Time for the connection to a server."""


def check_onnxruntime(config: Config) -> Iterator[Finding]:
    """Check that onnxruntime works and has the configured execution providers."""
    detector = config.perception.detector
    wanted = detector.providers if detector.kind == "onnx" else ()
    needed = any(name != TENSORRT for name in wanted)
    level_if_missing: Level = "fail" if needed else "warn"
    if all(map(is_installed, DISTRIBUTIONS)):
        todo = "pip uninstall onnxruntime onnxruntime-gpu, then install only one of them"
        yield warn("onnxruntime and onnxruntime-gpu are both installed", todo)
    if find_spec("onnxruntime") is None:
        what = "onnxruntime is not installed, so no neural detector can run"
        yield Finding(level_if_missing, what, "pip install 'edge-vln[cpu]' (or [gpu])")
        return
    versions = (metadata.version(name) for name in DISTRIBUTIONS if is_installed(name))
    what = f"onnxruntime {next(versions, '')}".strip()
    if fault := fault_of(CPU):
        todo = (
            "another version may work (pip install 'onnxruntime==1.20.1'), and on arm64 all cores "
            "must be on (Jetson: sudo nvpmodel -m 0; not under qemu): docs/install.md"
        )
        yield Finding(level_if_missing, f"{what}: {fault}", todo)
        return
    import onnxruntime

    available = onnxruntime.get_available_providers()
    names = ", ".join(name.removesuffix("ExecutionProvider") for name in available)
    yield ok(f"{what} runs a model; execution providers: {names}")
    if CUDA in available and (fault := fault_of(CUDA)):
        todo = f"check the GPU driver and CUDA, or use {CPU}"
        yield warn(f"{what} fails on {CUDA}: {fault}", todo)
    key = "perception.detector.providers"
    for name in wanted:
        if name != TENSORRT and name not in available:
            todo = f"install an onnxruntime with this provider, or change {key}"
            yield fail(f"{key}: {name} is not in the installed onnxruntime", todo)


def check_tensorrt(config: Config) -> Iterator[Finding]:
    """Check that TensorRT works, if the detector uses it."""
    detector = config.perception.detector
    if detector.kind != "onnx" or TENSORRT not in detector.providers:
        return
    try:
        version = tensorrt.load().__version__
        cuda.Device(detector.device_id)
    except UserError as error:
        yield finding_of(error)
    else:
        yield ok(f"TensorRT {version}, on GPU {detector.device_id}")


def check_models(config: Config) -> Iterator[Finding]:
    """Check the files of all models that are here.

    A model that the configuration names and that is not here is reported by `check_configuration`.
    """
    from edge.perception.runtime.cards import ModelError, card_names, check_installed, load_card

    needed = {model.name for model in named_models(config)}
    names = sorted({*card_names(), *needed})
    if not names:
        yield warn("no model cards: the package's folder models/ is missing", "reinstall edge-vln")
    n_absent = 0
    for name in names:
        try:
            card = load_card(name)
        except ModelError as error:
            if name not in needed:
                yield finding_of(error, "warn")
            continue
        try:
            served = [file.server for file in card.files if file.server is not None]
            try:
                check_installed(card)
            except ModelError:
                n_absent += name not in needed
                continue
            paths = [_verify(file) for file in card.files if file.server is None]
        except ModelError as error:
            yield finding_of(error, "fail" if name in needed else "warn")
        else:
            yield from (ok(f"model {name}: {path}") for path in paths)
            yield from (_server_finding(name, server.url) for server in served)
    if n_absent:
        what = "other models are not on this machine, and this configuration needs none of them"
        yield ok(f"{n_absent} {what} (`edge models list`)")


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
        return ok(f"model {name}: a server listens at {shown}")
    todo = "start the server, or correct its URL in the model card"
    return warn(f"model {name}: no server listens at {shown}", todo)


def check_background(config: Config) -> Iterator[Finding]:
    """Check that the detector's text encoder knows the background words."""
    from edge.perception.embedding.encoders import make_text_encoder
    from edge.perception.embedding.text import words_for
    from edge.perception.runtime.cards import load_detector_card

    detector = config.perception.detector
    if detector.kind != "onnx" or crashes():
        return
    try:
        encoder = make_text_encoder(load_detector_card(detector.model), detector.vocabulary)
    except UserError:  # as the check of the configuration reports
        return
    known = words_for(detector.background, encoder.resolve)
    if unknown := [word for word in detector.background if word not in known]:
        what = (
            f"model {detector.model} does not know {len(unknown)} of the "
            f"{len(detector.background)} words of perception.detector.background"
        )
        yield warn(what, f"remove or replace these words: {', '.join(unknown)}")


def check_choice_server(config: Config) -> Iterator[Finding]:
    """Check that the server of the choice among frontiers listens."""
    choice = config.perception.choice
    if choice.kind in ("openai", "text") and not _listens(choice.url):
        todo = "start the server, or correct the URL; until then no model chooses among frontiers"
        yield warn(f"perception.choice.url: no server listens at {redact(choice.url)}", todo)


def _listens(url: str) -> bool:
    """Return True if a TCP connection to the server of a URL can be opened."""
    parts = urlsplit(url)
    try:
        port = parts.port or {"http": 80, "https": 443}[parts.scheme]
        socket.create_connection((parts.hostname, port), SERVER_S).close()
    except (OSError, KeyError, ValueError):  # the last two: an invalid URL
        return False
    return True
