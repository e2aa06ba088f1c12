"""Model cards: what a model file is, where it came from, what it needs."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from edge import resources
from edge.errors import UserError

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class ModelError(UserError):
    """A model that cannot be used: one line that says what, where and what to do."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SourceUrl(_Part):
    kind: Literal["url"]
    url: str
    sha256: Sha256


class SourceWheel(_Part):
    kind: Literal["wheel"]
    package: str
    member: str
    sha256: Sha256


class Input(_Part):
    height: Annotated[int, Field(ge=32, multiple_of=32)]
    width: Annotated[int, Field(ge=32, multiple_of=32)]


class Preprocess(_Part):
    """Pixels as the network wants them: `rgb * scale`, the frame around them `letterbox_pad`."""

    color: Literal["rgb"]
    scale: Annotated[float, Field(gt=0)]
    letterbox_pad: Annotated[int, Field(ge=0, le=255)]


class Parity(_Part):
    """How the model compares with the step before it, on images it was not calibrated on."""

    reference: str
    images: int
    recall: float
    precision: float
    score_error: float


class Card(_Part):
    """One model variant.

    Attributes:
        file: name of the ONNX file in the models' cache.
        sha256: of the file; None when it is made here, then `FILE.json` beside it holds it.
        sources: where the weights it is made from can be had.
        text_dim: length of a text embedding.
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9.-]+$")]
    family: str
    task: Literal["detect"]
    file: Annotated[str, Field(pattern=r"^[^/\\]+\.onnx$")]
    sha256: Sha256 | None
    sources: tuple[Annotated[Union[SourceUrl, SourceWheel], Field(discriminator="kind")], ...]
    license: str
    input: Input
    precision: Literal["fp32", "fp16", "int8-cpu", "int8-trt"]
    derived_from: str | None
    preprocess: Preprocess
    text_dim: Annotated[int, Field(ge=1)]
    parity: Parity | None

    @property
    def path(self) -> Path:
        """Where the ONNX file lies, if it is there."""
        return resources.models_dir() / self.file

    @property
    def sidecar(self) -> Path:
        return self.path.with_name(self.file + ".json")


def card_names() -> list[str]:
    return sorted(path.stem for path in resources.data_dir("models").glob("*.yaml"))


def load_card(name: str) -> Card:
    """The card of a model.

    Raises:
        ModelError: no such card, or one that is not valid (file, key, what is wrong).
    """
    path = resources.data_dir("models") / f"{name}.yaml"
    if not path.is_file():
        choices = ", ".join(card_names()) or "none"
        raise ModelError(f"model {name!r}: no such card (choices: {choices})")
    return read_card(path)


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
        raise ModelError(f"{path}: expected keys such as name, file, input")
    try:
        card = Card.model_validate(data)
    except ValidationError as error:
        raise ModelError("\n".join(_explain(path, fault) for fault in error.errors())) from None
    if card.name != path.stem:
        raise ModelError(f"{path}: name: {card.name!r}, must be the file's name {path.stem!r}")
    return card


def _explain(path: Path, fault: Any) -> str:
    key = ".".join(str(part) for part in fault["loc"])
    if fault["type"] == "missing":
        return f"{path}: {key}: missing"
    if fault["type"] == "extra_forbidden":
        return f"{path}: {key}: unknown key (choices: {', '.join(sorted(Card.model_fields))})"
    message = fault["msg"]
    return f"{path}: {key}: {message[0].lower()}{message[1:]}, got {fault.get('input')!r:.80}"


def verify_model(card: Card) -> Path:
    """The model's file, after its hash was checked (once per path, size and time of change).

    Raises:
        ModelError: the file or its hash is missing, or they do not belong together.
    """
    export = f"run `edge models export {card.name} --weights FILE.pt`"
    if not card.path.is_file():
        raise ModelError(f"{card.path}: model {card.name} is not there; {export}")
    expected, size = _expected(card, export)
    found_size = card.path.stat().st_size
    if size is not None and found_size != size:
        what = "truncated" if found_size < size else "longer than it was made"
        raise ModelError(f"{card.path}: {what}: {found_size} of {size} bytes; {export}")
    if _cached_sha256(card.path) != expected:
        raise ModelError(
            f"{card.path}: damaged or another model: sha256 is not {expected[:12]}…; {export}"
        )
    return card.path


def _expected(card: Card, export: str) -> tuple[str, int | None]:
    """(sha256, size in bytes if known) from the card, else from the sidecar of the export."""
    if card.sha256 is not None:
        return card.sha256, None
    try:
        data = json.loads(card.sidecar.read_text(encoding="utf-8"))
        expected, size = str(data["sha256"]), data.get("bytes")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ModelError(
            f"{card.sidecar}: no sha256 to check the model against "
            f"({type(error).__name__}); {export}"
        ) from None
    return expected, int(size) if isinstance(size, int) else None


def made_parity(card: Card) -> Parity | None:
    """The parity that the export wrote beside the model, None where there is none."""
    try:
        return Parity.model_validate(json.loads(card.sidecar.read_text(encoding="utf-8"))["parity"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def sha256_of(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _cached_sha256(path: Path) -> str:
    """Hash of a file; remembered across starts in the cache, as large files take a while."""
    stat = path.stat()
    key = f"{path.resolve()}|{stat.st_size}|{stat.st_mtime_ns}"
    memory = resources.cache_dir() / "sha256.json"
    try:
        known = json.loads(memory.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        known = {}
    if isinstance(known, dict) and isinstance(known.get(key), str):
        return known[key]
    digest = sha256_of(path)
    prefix = f"{path.resolve()}|"
    known = {k: v for k, v in dict(known).items() if not k.startswith(prefix)} | {key: digest}
    _write_quietly(memory, json.dumps(known, indent=1))
    return digest


def _write_quietly(path: Path, text: str) -> None:
    """Atomic; a read-only cache only costs hashing again."""
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink()
