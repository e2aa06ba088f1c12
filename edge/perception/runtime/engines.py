"""Engines of TensorRT that were built once and are found again: one folder per model and machine.

    <cache>/<key>/engine.json     what the engine was built from, and the digests of its files
    <cache>/<key>/…               the engine, as TensorRT or onnxruntime wrote it
    <cache>/<key>.lock            held while it is built, so that no second process builds it too

A folder gets its name only when everything in it is written, so an engine is there whole or not
at all. Nothing here knows TensorRT.
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
from edge.perception.runtime.health import Health, Tell, log_progress
from edge.perception.runtime.model_file import (
    ModelError,
    check_unchanged,
    remembered_sha256,
    sha256_of,
)

log = logging.getLogger(__name__)

MIN_FREE_BYTES = 256 << 20
"""Room that an engine of the models here needs, with some to spare."""
TELL_EVERY_S = 5.0
_MANIFEST = "engine.json"
_MODE = 0o755  # of an engine's folder: that of a temporary one shuts out the cache's other users
_FIRST = "this takes minutes the first time"

Shape = tuple[int, ...]
Key = Mapping[str, object]
"""What an engine depends on by name; another of any of these needs another engine."""


@dataclass(frozen=True)
class EngineOptions:
    """What TensorRT needs to know of a model beyond its file.

    Attributes:
        model: the card's name.
        precision: the card's: `fp32`, `fp16` or `int8-trt`.
        shapes: least, usual and largest shape of every input whose shape may change.
        cache: folder for engines, None: `engines` in the service's cache.
        progress: told while an engine is built.
        sha256: of the file when it is sound, None: of what it was when it was last looked at.
    """

    model: str
    precision: str
    shapes: Mapping[str, tuple[Shape, Shape, Shape]] = field(default_factory=dict)
    cache: Path | None = None
    progress: Tell = log_progress
    sha256: str | None = None

    @property
    def folder(self) -> Path:
        return self.cache or resources.cache_dir() / "engines"


def engine_of(
    path: Path,
    options: EngineOptions,
    build: Callable[[Path, Callable[[str], None]], None],
    device_id: int,
    **built_with: object,
) -> Path:
    """The folder with a model's engine, which is built if it is not there.

    Args:
        path: the ONNX file; it is hashed anew before anything is made of it.
        build: writes the engine into the (empty) folder that it is given, and says in a few words
            how far it is.
        device_id: the GPU: an engine was timed on one of its name, and others have the same
            compute capability.
        built_with: the builder, TensorRT's version, and a count of our settings of the builder.

    Raises:
        ModelError: there is no GPU, the file is damaged, or the cache cannot be used.
    """
    sha256 = options.sha256 or remembered_sha256(path)
    gpu, capability = gpu_of(device_id)
    key = {
        "model": options.model,
        "sha256": sha256,
        "precision": options.precision,
        "shapes": repr(sorted(options.shapes.items())),
        "gpu": gpu,
        "sm": capability,
        **built_with,
    }

    def build_and_tell(folder: Path) -> None:
        check_unchanged(path, sha256)
        with telling(options.model, options.progress) as note:
            build(folder, note)

    return obtain(key, options.folder, build_and_tell, options.progress)


@contextlib.contextmanager
def telling(
    model: str, progress: Tell, first: str = _FIRST, every_s: float = TELL_EVERY_S
) -> Iterator[Callable[[str], None]]:
    """Within the block, `progress` hears at once and then every few seconds that an engine is
    built, so that it does not look like a hang.

    Args:
        first: how far it is at first.

    Yields:
        Takes how far it is, told with the next beat; from any thread.
    """
    over, notes, start_s = threading.Event(), [first], time.monotonic()

    def tell() -> None:
        while True:
            took_s = time.monotonic() - start_s
            progress(Health("building engine", f"{model}: {took_s:.0f} s, {notes[-1]}"))
            if over.wait(every_s):
                return

    def note(text: str) -> None:
        notes[:] = [text or first]

    thread = threading.Thread(target=tell, name="building", daemon=True)
    thread.start()
    try:
        yield note
    finally:
        over.set()
        thread.join()


def folder_name(key: Key) -> str:
    """Of the folder that a key's engine lies in."""
    content = json.dumps(key, sort_keys=True).encode()
    return f"{key['model']}-{hashlib.sha256(content).hexdigest()[:20]}"


def obtain(key: Key, cache: Path, build: Callable[[Path], None], progress: Tell) -> Path:
    """The folder of an engine, which is built if it is not there; readable for every user.

    Args:
        build: writes the engine's files into the (empty) folder that it is given.
        progress: told while another process builds the same engine.

    Raises:
        ModelError: the cache cannot be used; nothing was built then.
    """
    name = folder_name(key)
    folder = cache / name
    if damage(folder) is None:  # also where nothing can be written
        return folder
    check_usable(cache)
    with _locked(cache / f"{name}.lock", progress):
        if folder.exists():
            fault = damage(folder)
            if fault is None:
                return folder
            log.warning("engine %s: %s; it is built again", folder, fault)
            _remove(folder, fault)
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
                f"{cache}: the engine cannot be kept ({error.strerror or error}); free some room, "
                "or set perception.detector.engine_cache"
            ) from None
        finally:
            shutil.rmtree(made, ignore_errors=True)
    return folder


def _remove(folder: Path, fault: str) -> None:
    """Remove an engine that is of no use; ModelError where that is not allowed."""
    shutil.rmtree(folder, ignore_errors=True)
    if folder.exists():
        raise ModelError(
            f"{folder}: of no use ({fault}) and cannot be removed; remove it as the user who owns "
            "it, or set perception.detector.engine_cache"
        )


def check_usable(cache: Path) -> None:
    """Raise ModelError unless engines can be written to `cache`; a build may take minutes."""
    todo = "make it writable, or set perception.detector.engine_cache"
    try:
        make_writable(cache)
        free = shutil.disk_usage(cache).free
    except OSError as error:
        reason = error.strerror or str(error)
        raise ModelError(f"{cache}: no place for engines ({reason}); {todo}") from None
    if free < MIN_FREE_BYTES:
        raise ModelError(
            f"{cache}: {free >> 20} MB free, an engine may need {MIN_FREE_BYTES >> 20} MB; "
            "free some room, or set perception.detector.engine_cache"
        )


def damage(folder: Path) -> str | None:
    """What is wrong with an engine's folder, None if it is as it was written."""
    try:
        files = json.loads(read_regular(folder / _MANIFEST))["files"]
        for name, digest in files.items():
            if sha256_of(folder / name) != digest:
                return f"{name} is damaged"
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        return f"incomplete ({type(error).__name__})"
    return None if files else "empty"


def _seal(made: Path, key: Key) -> None:
    """Write down what was built, and have all of it on the disk."""
    files = {path.name: sha256_of(path) for path in sorted(made.iterdir()) if path.is_file()}
    if not files:
        raise ModelError(f"model {key['model']}: the build left no engine; see the log for why")
    content = json.dumps({"key": dict(key), "files": files}, indent=1)
    (made / _MANIFEST).write_text(content, encoding="utf-8")
    for path in made.iterdir():
        if path.is_file():
            sync(path)


@contextlib.contextmanager
def _locked(path: Path, progress: Tell) -> Iterator[None]:
    """Hold a lock that the system lets go when its holder dies."""
    try:
        file = path.open("a")
    except OSError as error:
        raise ModelError(f"{path}: cannot be written ({error.strerror}); remove it") from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            with telling(path.stem, progress, "another process builds it, waiting"):
                fcntl.flock(file, fcntl.LOCK_EX)
        yield
