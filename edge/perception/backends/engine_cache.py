"""Engines that were built once and are found again: one folder per model and machine.

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
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from edge.host.files import read_regular
from edge.perception.detector import Health, Progress
from edge.perception.model_file import ModelError, sha256_of

log = logging.getLogger(__name__)

MIN_FREE_BYTES = 256 << 20
"""Room that an engine of the models here needs, with some to spare."""
_MANIFEST = "engine.json"
_MODE = 0o755  # of an engine's folder: that of a temporary one shuts out the cache's other users
_WAIT_S = 0.5
_TELL_EVERY = 10


@dataclass(frozen=True)
class EngineKey:
    """What an engine depends on; another of any of these needs another engine.

    Attributes:
        model: the card's name, for people.
        sha256: of the ONNX file.
        builder: `tensorrt`, or `onnxruntime` with its version.
        tensorrt: TensorRT's version.
        sm: compute capability of the GPU, such as `8.7`.
        gpu: its name: an engine was timed on it, and others have the same `sm`.
        precision: of the model's card.
        shapes: least, usual and largest shape of every input whose shape may change.
        recipe: counts our own settings of the builder.
    """

    model: str
    sha256: str
    builder: str
    tensorrt: str
    sm: str
    gpu: str
    precision: str
    shapes: str
    recipe: int

    @property
    def folder(self) -> str:
        """Name of the engine's folder."""
        content = json.dumps(asdict(self), sort_keys=True).encode()
        return f"{self.model}-{hashlib.sha256(content).hexdigest()[:20]}"


def obtain(key: EngineKey, cache: Path, build: Callable[[Path], None], progress: Progress) -> Path:
    """The folder of an engine, which is built if it is not there; readable for every user.

    Args:
        build: writes the engine's files into the (empty) folder that it is given.
        progress: told while another process builds the same engine.

    Raises:
        ModelError: the cache cannot be used; nothing was built then.
    """
    folder = cache / key.folder
    if damage(folder) is None:  # also where nothing can be written
        return folder
    check_usable(cache)
    with _locked(cache / f"{key.folder}.lock", progress):
        if folder.exists():
            fault = damage(folder)
            if fault is None:
                return folder
            log.warning("engine %s: %s; it is built again", folder, fault)
            _remove(folder, fault)
        for left_over in cache.glob(f".{key.folder}.*"):  # of a build that was killed
            shutil.rmtree(left_over, ignore_errors=True)
        made = Path(tempfile.mkdtemp(dir=cache, prefix=f".{key.folder}."))
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
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=cache, prefix=".probe."):
            pass
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


def _seal(made: Path, key: EngineKey) -> None:
    """Write down what was built, and have all of it on the disk."""
    files = {path.name: sha256_of(path) for path in sorted(made.iterdir()) if path.is_file()}
    if not files:
        raise ModelError(f"model {key.model}: the build left no engine; see the log for why")
    content = json.dumps({"key": asdict(key), "files": files}, indent=1)
    (made / _MANIFEST).write_text(content, encoding="utf-8")
    for path in made.iterdir():
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())


@contextlib.contextmanager
def _locked(path: Path, progress: Progress) -> Iterator[None]:
    """Hold a lock that the system lets go when its holder dies."""
    try:
        file = path.open("a")
    except OSError as error:
        raise ModelError(f"{path}: cannot be written ({error.strerror}); remove it") from None
    with file:
        waits = 0
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if waits % _TELL_EVERY == 0:
                    what = f"another process builds it, waiting for {waits * _WAIT_S:.0f} s"
                    progress(Health("building engine", f"{path.stem}: {what}"))
                waits += 1
                time.sleep(_WAIT_S)
        yield
