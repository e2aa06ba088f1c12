"""Model cards: reading them, and holding a model's file against its card."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import Field, TypeAdapter, ValidationError

from edge import resources
from edge.perception.card_types import (
    BaseCard,
    Card,
    DetectCard,
    FileCard,
    ImageCard,
    Parity,
    SimilarityCard,
    TextCard,
)
from edge.perception.interface import check_file
from edge.perception.model_file import ModelError, remembered_sha256

C = TypeVar("C", bound=BaseCard)

_BY_TASK: dict[str, type[BaseCard]] = {
    "detect": DetectCard,
    "text": TextCard,
    "image": ImageCard,
    "similarity": SimilarityCard,
}
_ANY: TypeAdapter[Card] = TypeAdapter(Annotated[Card, Field(discriminator="task")])


def card_names() -> list[str]:
    return sorted(path.stem for path in resources.data_dir("models").glob("*.yaml"))


def card_path(name: str) -> Path:
    """Where the card of this name is, or would be."""
    return resources.data_dir("models") / f"{name}.yaml"


def load_card(name: str) -> Card:
    """The card of a model, of any task.

    Raises:
        ModelError: no such card, or one that is not valid (file, key, what is wrong).
    """
    names = card_names()
    if name not in names:
        raise ModelError(f"model {name!r}: no such card (choices: {', '.join(names) or 'none'})")
    return read_card(card_path(name))


def load_detector_card(name: str) -> DetectCard:
    """See `load_card`; raises ModelError for a card of another task too."""
    return _of_task(load_card(name), DetectCard)


def load_text_card(name: str) -> TextCard:
    """See `load_detector_card`."""
    return _of_task(load_card(name), TextCard)


def load_image_card(name: str) -> ImageCard:
    """See `load_detector_card`."""
    return _of_task(load_card(name), ImageCard)


def load_similarity_card(name: str) -> SimilarityCard:
    """See `load_detector_card`."""
    return _of_task(load_card(name), SimilarityCard)


def _of_task(card: Card, kind: type[C]) -> C:
    if isinstance(card, kind):
        return card
    wanted = next(task for task, other in _BY_TASK.items() if other is kind)
    raise ModelError(f"model {card.name!r}: is a model of task {card.task!r}, not {wanted!r}")


def all_cards() -> list[Card]:
    """Every card, by name; see `load_card`."""
    return [load_card(name) for name in card_names()]


def read_card(path: Path) -> Card:
    """Read and validate one card; see `load_card`."""
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ModelError(f"{path}: cannot be read: {' '.join(str(error).split())}") from None
    if not isinstance(data, dict):
        raise ModelError(f"{path}: expected keys such as name, task, file")
    try:
        card = _ANY.validate_python(data)
    except ValidationError as error:
        raise ModelError("\n".join(_explain(path, fault) for fault in error.errors())) from None
    if card.name != path.stem:
        raise ModelError(f"{path}: name: {card.name!r}, must be the file's name {path.stem!r}")
    return card


def _explain(path: Path, fault: Any) -> str:
    """One line for one fault; pydantic puts tasks and kinds into the key, no file has them."""
    kind, context = fault["type"], fault.get("ctx", {})
    task, *keys = fault["loc"] or ("",)
    tagged = [isinstance(before, int) or before == "tokenizer" for before in ("", *keys)]
    key = ".".join(str(part) for part, tag in zip(keys, tagged, strict=False) if not tag)
    if kind == "union_tag_not_found":
        return f"{path}: {'.'.join([key, 'kind']) if keys else 'task'}: missing"
    if kind == "union_tag_invalid":
        choices = context["expected_tags"].replace("'", "")
        field = f"{key}.kind" if keys else "task"
        return f"{path}: {field}: unknown {context['tag']!r} (choices: {choices})"
    if kind == "missing":
        return f"{path}: {key}: missing"
    if kind == "extra_forbidden":
        card = _BY_TASK.get(str(task))
        choices = f" (choices: {', '.join(sorted(card.model_fields))})" if len(keys) == 1 else ""
        return f"{path}: {key}: unknown key{choices}"
    message = fault["msg"].removeprefix("Value error, ")
    got = "" if isinstance(fault.get("input"), dict) else f", got {fault.get('input')!r:.80}"
    return f"{path}: {key or task}: {message[0].lower()}{message[1:]}{got}"


def verify_model(card: FileCard) -> Path:
    """The model's file, sound as far as can be seen without running it.

    Its hash is the card's (computed once per path, size and time of change), and it is an ONNX
    model with the card's inputs and outputs; see `edge.perception.interface`.

    Raises:
        ModelError: the file or its hash is missing, they do not belong together, or no session
            should be made of it.
    """
    todo = how_to_get(card)
    if not card.path.is_file():
        raise ModelError(f"{card.path}: model {card.name} is not there; {todo}")
    expected, size = _expected(card, todo)
    found_size = card.path.stat().st_size
    if size is not None and found_size != size:
        what = "truncated" if found_size < size else "longer than it was made"
        raise ModelError(f"{card.path}: {what}: {found_size} of {size} bytes; {todo}")
    if remembered_sha256(card.path) != expected:
        raise ModelError(
            f"{card.path}: damaged or another model: sha256 is not {expected[:12]}…; {todo}"
        )
    check_file(card.path, card)
    return card.path


def how_to_get(card: FileCard) -> str:
    """What to do for a model's file: a command, for the end of a message."""
    if card.path.parent == resources.data_dir("models"):
        return "reinstall edge-vln, which brings it"
    if any(source.sha256 == card.sha256 for source in card.sources):
        return f"run `edge models pull {card.name}`"
    return f"run `edge models export {card.name}`"


def _expected(card: FileCard, todo: str) -> tuple[str, int | None]:
    """(sha256, size in bytes if known) from the card, else from the sidecar of the export."""
    if card.sha256 is not None:
        return card.sha256, None
    try:
        data = json.loads(card.sidecar.read_text(encoding="utf-8"))
        expected, size = str(data["sha256"]), data.get("bytes")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ModelError(
            f"{card.sidecar}: no sha256 to check the model against ({type(error).__name__}); {todo}"
        ) from None
    return expected, int(size) if isinstance(size, int) else None


def made_parity(card: FileCard) -> Parity | None:
    """The parity that the export wrote beside the model, None where there is none."""
    try:
        return Parity.model_validate(json.loads(card.sidecar.read_text(encoding="utf-8"))["parity"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
