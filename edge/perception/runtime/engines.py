"""Cache of TensorRT engines, since a build takes minutes: one folder per model and machine.

An engine is a network that TensorRT has tuned for one GPU.

    <cache>/<key>/engine.json     what the engine was built from, and the digests of its files
    <cache>/<key>/…               the engine, as TensorRT or onnxruntime wrote it
    <cache>/<key>.lock            held during a build, so that no second process builds the same

A folder gets its name only after everything in it is written, so an engine is complete or absent.
This module does not use TensorRT.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import logging
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from edge.host import resources
from edge.host.files import make_writable, read_regular, sync
from edge.perception.runtime.cuda import gpu_of
from edge.perception.runtime.health import ModelHealth, ProgressCallback, log_progress
from edge.perception.runtime.model_file import (
    ModelError,
    check_unchanged,
    remembered_sha256,
    sha256_of,
)

log = logging.getLogger(__name__)

MIN_FREE_BYTES = 256 << 20
"""Least free disk space for a build: enough for the models here, with a reserve."""
REPORT_PERIOD_S = 5.0
"""Period of progress reports during a build."""
DETECTOR = "perception.detector"
"""Section of the configuration with `engine_cache`."""
_MANIFEST = "engine.json"
_MODE = 0o755  # of an engine's folder: mkdtemp's mode would exclude other users of the cache
_FIRST = "this takes minutes the first time"  # progress text before the builder reports any

Shape = tuple[int, ...]
Key = Mapping[str, object]
"""Properties that an engine depends on, by name; if one changes, another engine is needed."""


@dataclass(frozen=True)
class EngineOptions:
    """TensorRT options of a model that its file does not contain.

    Attributes:
        model: the card's name.
        precision: precision of the card: `fp32`, `fp16` or `int8-trt`.
        shapes: least, usual and largest shape of every input whose shape may change, by its name.
        cache: folder for engines; None: `engines` in the service's cache.
        progress: called during a build.
        section: section of the configuration that names the model, for messages.
    """

    model: str
    precision: str
    shapes: Mapping[str, tuple[Shape, Shape, Shape]] = field(default_factory=dict)
    cache: Path | None = None
    progress: ProgressCallback = log_progress
    section: str = DETECTOR

    @property
    def folder(self) -> Path:
        return self.cache or resources.cache_dir() / "engines"

    @property
    def cache_key(self) -> str:
        """Return the key or variable that sets the folder, for messages."""
        return f"{DETECTOR}.engine_cache" if self.section == DETECTOR else "EDGE_CACHE_DIR"


def cached_engine(
    path: Path,
    options: EngineOptions,
    build: Callable[[Path, Callable[[str], None]], None],
    device_id: int,
    **built_with: object,
) -> Path:
    """Return the folder with a model's engine; build it if it is missing.

    Args:
        path: the ONNX file; it is hashed again before a build.
        options: see `EngineOptions`.
        build: called with an empty folder and a function for progress texts; writes the engine
            into the folder.
        device_id: number of the GPU. The engine is tuned for its name and compute capability.
        **built_with: further parts of the engine's key: the builder, TensorRT's version, and the
            version of our builder settings.

    Raises:
        ModelError: there is no GPU, the file is damaged, or the cache cannot be used.
    """
    sha256 = remembered_sha256(path)
    gpu, capability = gpu_of(device_id, options.section)
    key = {
        "model": options.model,
        "sha256": sha256,
        "precision": options.precision,
        "shapes": repr(sorted(options.shapes.items())),
        "gpu": gpu,
        "sm": capability,
        **built_with,
    }

    def build_with_progress(folder: Path) -> None:
        check_unchanged(path, sha256)
        with report_progress(options.model, options.progress) as note:
            build(folder, note)

    return get_or_build(
        key, options.folder, build_with_progress, options.progress, options.cache_key
    )


@contextlib.contextmanager
def report_progress(
    model: str, progress: ProgressCallback, first: str = _FIRST, every_s: float = REPORT_PERIOD_S
) -> Iterator[Callable[[str], None]]:
    """Call `progress` at once and then every few seconds: a build must not look like a hang.

    Args:
        model: name of the model.
        progress: called with the state `building engine`.
        first: progress text until the first call of the function.
        every_s: period in seconds.

    Yields:
        A function that sets the progress text, for any thread.
    """
    # `notes` has one text; it is a list, so that `note` can replace it.
    ended, notes, start_s = threading.Event(), [first], time.monotonic()

    def report() -> None:
        while True:
            took_s = time.monotonic() - start_s
            progress(ModelHealth("building engine", f"{model}: {took_s:.0f} s, {notes[-1]}"))
            if ended.wait(every_s):
                return

    def note(text: str) -> None:
        notes[:] = [text or first]

    thread = threading.Thread(target=report, name="building", daemon=True)
    thread.start()
    try:
        yield note
    finally:
        ended.set()
        thread.join()


def folder_name(key: Key) -> str:
    """Return the name of the folder of a key's engine."""
    content = json.dumps(key, sort_keys=True).encode()
    return f"{key['model']}-{hashlib.sha256(content).hexdigest()[:20]}"


def get_or_build(
    key: Key,
    cache: Path,
    build: Callable[[Path], None],
    progress: ProgressCallback,
    cache_key: str = f"{DETECTOR}.engine_cache",
) -> Path:
    """Return the folder of an engine, readable for every user; build it if it is missing.

    `cache_key` is the key or variable that sets `cache`, for messages.

    Raises:
        ModelError: the cache cannot be used; nothing was built then.
    """
    name = folder_name(key)
    folder = cache / name
    if damage(folder) is None:  # also works in a read-only cache
        return folder
    check_usable(cache, cache_key)
    with _locked(cache / f"{name}.lock", progress):
        if folder.exists():
            fault = damage(folder)
            if fault is None:
                return folder
            log.warning("engine %s: %s; the engine is built again", folder, fault)
            _remove(folder, fault, cache_key)
        for left_over in cache.glob(f".{name}.*"):  # of a build that was killed
            shutil.rmtree(left_over, ignore_errors=True)
        made = Path(tempfile.mkdtemp(dir=cache, prefix=f".{name}."))
        try:
            build(made)
            _seal(made, key)
            made.chmod(_MODE)
            made.rename(folder)
        except OSError as error:
            raise ModelError(
                f"{cache}: the engine cannot be saved ({error.strerror or error}); free some disk "
                f"space, or set {cache_key}"
            ) from None
        finally:
            shutil.rmtree(made, ignore_errors=True)
    return folder


def _remove(folder: Path, fault: str, cache_key: str) -> None:
    """Remove a damaged engine; raise ModelError if that is not allowed."""
    shutil.rmtree(folder, ignore_errors=True)
    if folder.exists():
        raise ModelError(
            f"{folder}: the engine is unusable ({fault}), and this user cannot remove the folder; "
            f"remove it as its owner, or set {cache_key}"
        )


def check_usable(cache: Path, cache_key: str) -> None:
    """Raise ModelError unless `cache` is writable with enough space, before a build of minutes."""
    todo = f"make it writable, or set {cache_key}"
    try:
        make_writable(cache)
        free = shutil.disk_usage(cache).free
    except OSError as error:
        reason = error.strerror or str(error)
        raise ModelError(f"{cache}: cannot hold engines ({reason}); {todo}") from None
    if free < MIN_FREE_BYTES:
        raise ModelError(
            f"{cache}: {free >> 20} MB free, an engine may need {MIN_FREE_BYTES >> 20} MB; "
            f"free some disk space, or set {cache_key}"
        )


def damage(folder: Path) -> str | None:
    """Return the damage of an engine's folder; None if all files are there as written."""
    try:
        files = json.loads(read_regular(folder / _MANIFEST))["files"]
        for name, digest in files.items():
            if sha256_of(folder / name) != digest:
                return f"{name} is damaged"
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        return f"incomplete ({type(error).__name__})"
    return None if files else "empty"


def _seal(made: Path, key: Key) -> None:
    """Write the manifest, and sync all files to the disk."""
    files = {path.name: sha256_of(path) for path in sorted(made.iterdir()) if path.is_file()}
    if not files:
        raise ModelError(f"model {key['model']}: the build left no engine; see the log for why")
    content = json.dumps({"key": dict(key), "files": files}, indent=1)
    (made / _MANIFEST).write_text(content, encoding="utf-8")
    for path in made.iterdir():
        if path.is_file():
            sync(path)


@contextlib.contextmanager
def _locked(path: Path, progress: ProgressCallback) -> Iterator[None]:
    """Hold a lock on a file; if this process dies, the system releases it."""
    try:
        file = path.open("a")
    except OSError as error:
        raise ModelError(
            f"{path}: the lock file cannot be written ({error.strerror}); remove it"
        ) from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            with report_progress(path.stem, progress, "another process builds it, waiting"):
                fcntl.flock(file, fcntl.LOCK_EX)
        yield
