"""Reads model cards, and checks a model's files against them.

Cards come with the package or are in the models' cache. If both have a card of one name, the
package's card counts. A file that was made or pulled here may have a sidecar, `FILE.json` next to
it, with its hash, size and parity.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from edge.config.explain import explain_all
from edge.config.yaml_text import parse_yaml
from edge.host import resources
from edge.host.files import read_regular
from edge.perception.runtime.card_types import (
    BaseCard,
    Card,
    ChoiceCard,
    ClipTokenizer,
    DetectCard,
    EmbeddingParity,
    FileCard,
    FolderFile,
    GroundCard,
    ImageCard,
    MarksCard,
    Parity,
    SegmentCard,
    SimilarityCard,
    TextCard,
    TranslateCard,
)
from edge.perception.runtime.model_file import ModelError, fresh_sha256, known_sha256, trusts_cache
from edge.perception.runtime.onnx_file import check_file, check_network
from edge.text import bounded_repr, one_line, read_json_object, redact

log = logging.getLogger(__name__)

C = TypeVar("C", bound=BaseCard)

_BY_TASK: dict[str, type[Card]] = {
    "detect": DetectCard,
    "text": TextCard,
    "image": ImageCard,
    "segment": SegmentCard,
    "marks": MarksCard,
    "similarity": SimilarityCard,
    "choice": ChoiceCard,
    "translate": TranslateCard,
    "ground": GroundCard,
}


def card_names() -> list[str]:
    """Return the names of all cards, sorted."""
    return sorted(_card_paths())


def card_path(name: str) -> Path:
    """Return the path of the card of this name.

    Raises:
        ModelError: no such card.
    """
    paths = _card_paths()
    if name not in paths:
        choices = ", ".join(sorted(paths)) or "none"
        raise ModelError(f"model {bounded_repr(name)}: no such card (choices: {choices})")
    return paths[name]


def _card_paths() -> dict[str, Path]:
    """Return every card file by its card's name."""
    folders = (resources.models_dir(), resources.data_dir("models"))  # the later one wins
    return {path.stem: path for folder in folders for path in _cards_in(folder)}


def _cards_in(folder: Path) -> list[Path]:
    """Return the cards in a folder; none if it is missing or may not be read."""
    try:
        return [folder / name for name in os.listdir(folder) if name.endswith(".yaml")]
    except OSError:
        return []


def load_card(name: str) -> Card:
    """Load the card of a model, of any task.

    Raises:
        ModelError: no such card, or an invalid one (file, key, reason).
    """
    return read_card(card_path(name))


def load_detector_card(name: str) -> DetectCard:
    """Load a detector's card; see `load_card_of`."""
    return load_card_of(DetectCard, name)


def load_card_of(kind: type[C], name: str) -> C:
    """Load a card of one kind; see `load_card`.

    Raises:
        ModelError: also for a card of another task.
    """
    card = load_card(name)
    if isinstance(card, kind):
        return card
    wanted = next(task for task, other in _BY_TASK.items() if other is kind)
    raise ModelError(f"model {card.name!r}: is a model of task {card.task!r}, not {wanted!r}")


def all_cards() -> list[Card]:
    """Load every card, sorted by name; invalid ones are logged and left out."""
    found = []
    for _, path in sorted(_card_paths().items()):
        try:
            found.append(read_card(path))
        except ModelError as error:
            log.warning("%s; this model card is ignored", "; ".join(str(error).splitlines()))
    return found


def read_card(path: Path) -> Card:
    """Read and validate one card; see `load_card`."""
    try:
        data = parse_yaml(read_regular(path))
    except (OSError, ValueError) as error:
        raise ModelError(f"{path}: cannot be read: {one_line(error)}") from None
    if not isinstance(data, dict):
        raise ModelError(f"{path}: not a model card: expected keys such as name, task, file")
    task = data.get("task")
    if not isinstance(task, str) or task not in _BY_TASK:
        what = f"unknown {bounded_repr(task)}" if task else "missing"
        raise ModelError(f"{path}: task: {what} (choices: {', '.join(_BY_TASK)})")
    try:
        card = _BY_TASK[task].model_validate(data)
    except ValidationError as error:
        raise ModelError(explain_all(error, str(path), _BY_TASK[task])) from None
    if card.name != path.stem:
        raise ModelError(f"{path}: name: {card.name!r}, must be the file's name {path.stem!r}")
    return card


def check_installed(card: Card) -> None:
    """Check that every file of a card is here, unless a server runs the model.

    Raises:
        ModelError: a file is missing; the message names the first one and what to do.
    """
    for file in card.files:
        if isinstance(file, ChoiceCard):
            missing = [file.path_of(p) for p in file.parts if not os.path.isfile(file.path_of(p))]
        else:
            missing = [] if file.server is not None or file.is_here() else [file.path]
        if missing:
            raise ModelError(f"{missing[0]}: model {card.name} is not there; {install_hint(file)}")


def verify_model(card: FileCard, believe_cache: bool = False) -> Path:
    """Verify the model's file as far as possible without running the model; return the path.

    The file must have the card's hash, and be an ONNX model with the card's inputs and outputs; see
    `edge.perception.runtime.onnx_file`.

    Args:
        card: the model's card.
        believe_cache: True: if `$EDGE_TRUST_CACHE` is set, a file that was valid at the last check
            and has not changed since is not hashed.

    Raises:
        ModelError: the file or its hash is missing, they do not match, or the file is unusable.
    """
    path = card.path
    if card.server is not None:
        raise ModelError(f"model {card.name}: has no file here: {install_hint(card)}")
    _check_part(card, card, path, believe_cache)
    check_file(path, card)
    return path


def verify_parts(card: ChoiceCard, believe_cache: bool = False) -> None:
    """Verify the files of a model that has several, and the networks' formats; see `verify_model`.

    Raises:
        ModelError: as `verify_model`.
    """
    for part in card.parts:
        _check_part(card, part, card.path_of(part), believe_cache)
    covered = {part.file for part in card.parts}  # files whose hashes were checked
    for part in card.networks:
        folder = os.path.dirname(part.file)
        # `file` is relative to the part's folder. `d=folder` binds the folder of this part.
        check_network(card.path_of(part), lambda file, d=folder: os.path.join(d, file) in covered)


def _check_part(
    card: FileCard | ChoiceCard, part: FileCard | FolderFile, path: Path, believe_cache: bool
) -> None:
    """Raise ModelError if a file of a model is missing, has no known hash, or has another one."""
    if not os.path.isfile(path):
        raise ModelError(f"{path}: model {card.name} is not there; {install_hint(card)}")
    if not _check_hash(card, part, path, believe_cache):
        raise ModelError(
            f"{sidecar(path)}: no sha256 to check the file against; {install_hint(card)}"
        )


def expected_of(
    part: FileCard | FolderFile | ClipTokenizer, path: Path
) -> tuple[str | None, int | None]:
    """Return (sha256, size in bytes) of a file from its card, else from its `sidecar`.

    The sidecar was written when the file was made or first pulled.
    """
    if part.sha256 is not None:
        return part.sha256, None
    record = _read_sidecar(path)
    digest, size = record.get("sha256"), record.get("bytes")
    return digest if isinstance(digest, str) else None, size if isinstance(size, int) else None


def verify_file(card: FileCard, path: Path) -> bool:
    """Verify a file at any path as `verify_model` does; return True if a hash was compared.

    Raises:
        ModelError: the file is missing or does not match the card; see `verify_model`.
    """
    if not os.path.isfile(path):
        raise ModelError(f"{path}: no such file; name an ONNX file of {card.name}")
    compared = _check_hash(card, card, path)
    check_file(path, card)
    return compared


def _check_hash(
    card: FileCard | ChoiceCard,
    part: FileCard | FolderFile,
    path: Path,
    believe_cache: bool = False,
) -> bool:
    """Check the file's hash and size; return False if no hash is known to compare with."""
    expected, size = expected_of(part, path)
    if expected is None:
        return False
    found = path.stat().st_size
    if size is not None and found != size:
        what = "truncated" if found < size else "longer than expected"
        raise ModelError(f"{path}: {what}: {found} of {size} bytes; {install_hint(card)}")
    believed = believe_cache and trusts_cache() and known_sha256(path) == expected
    if not believed and fresh_sha256(path) != expected:
        raise ModelError(
            f"{path}: damaged or another model: sha256 is not {expected[:12]}…; "
            f"{install_hint(card)}"
        )
    return True


def install_hint(card: FileCard | ChoiceCard) -> str:
    """Return what to do to get a model's file, for the end of a message."""
    if isinstance(card, ChoiceCard):
        from_where = "" if card.url is not None else " --from FOLDER"
        return f"run `edge models pull {card.name}{from_where}`"
    if card.server is not None:
        return f"the server {redact(card.server.url)} runs it"
    if card.path.parent == resources.data_dir("models"):
        return "reinstall edge-vln, which brings it"
    if any(source.sha256 == card.sha256 for source in card.sources):
        return f"run `edge models pull {card.name}`"
    if card.task in ("segment", "ground"):
        return "export it with the tool of its project and put it there"
    return f"run `edge models export {card.name}`"


def sidecar(path: Path) -> Path:
    """Return the path of a file's record (hash, size, parity), which its export or pull wrote."""
    return path.with_name(path.name + ".json")


def _read_sidecar(path: Path) -> dict[str, Any]:
    """Return the content of a file's `sidecar`; {} if there is none."""
    try:
        return read_json_object(read_regular(sidecar(path)))
    except (OSError, ValueError):
        return {}


def made_parity(card: FileCard) -> Parity | EmbeddingParity | None:
    """Return the parity that the export wrote next to the model, None if there is none."""
    kind = EmbeddingParity if isinstance(card, (ImageCard, TextCard)) else Parity
    try:
        return kind.model_validate(_read_sidecar(card.path).get("parity"))
    except ValidationError:
        return None
