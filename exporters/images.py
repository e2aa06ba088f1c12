"""Images and prompts on which exports are calibrated and compared with their original."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from edge.host.files import read_regular
from edge.perception.embedding.text import PromptError, load_vocabulary
from edge.perception.runtime.letterbox import At, letterboxed
from exporters.files import ExportError

SUFFIXES = {".png", ".jpg", ".jpeg", ".ppm", ".bmp", ".webp"}


class Border(NamedTuple):
    """The border of an image whose aspect ratio is not the input's.

    Attributes:
        grey: its value, 0 to 255.
        at: place of the image; see `Preprocess`.
    """

    grey: int
    at: At


CENTRED = Border(114, "centre")  # as YOLO was trained with
PROMPTS = (
    "chair,armchair,sofa,bed,dining table,coffee table,desk,nightstand,cabinet,bookcase,"
    "refrigerator,microwave oven,oven,sink,toilet,bathtub,television,lamp,chandelier,vase,"
    "potted plant,picture frame,mirror,pillow,carpet,curtain,door,window,trash can,dumbbell,ball,"
    "box,bottle,book,person,car,bicycle,tree,traffic light,fan,clock"
)
"""Common targets of robots, separated by commas, in the words of the CLIP vocabulary file."""


@dataclass(frozen=True)
class TextEmbeddings:
    """Prompt words with their CLIP embeddings.

    Attributes:
        emb: (n, 512) float32, unit rows.
    """

    names: tuple[str, ...]
    emb: np.ndarray


def list_images(folder: Path) -> list[Path]:
    """Return the images of a folder and its subfolders, by name; raise ExportError if none."""
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise ExportError(
            f"{folder}: no images ({', '.join(sorted(SUFFIXES))}); give a folder of pictures "
            "from the robot's camera, or render some with exporters.render_calibration"
        )
    return paths


def digest_of(paths: list[Path]) -> str:
    """Return one sha256 over the contents of files, in the given order."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(hashlib.sha256(read_regular(path)).digest())
    return digest.hexdigest()


def load_input(path: Path, hw: tuple[int, int], border: Border = CENTRED) -> np.ndarray:
    """Return an image file as the detector's `images` input, (1, 3, H, W) float32 RGB 0..1."""
    return as_input(letterboxed(read_rgb(path), hw, *border)[0])


def read_rgb(path: Path) -> np.ndarray:
    """Return an image file as (h, w, 3) uint8; raise ExportError if it cannot be read."""
    # OpenCV would wait forever on a pipe.
    bgr = cv2.imread(str(path), cv2.IMREAD_COLOR) if path.is_file() else None
    if bgr is None:
        raise ExportError(f"{path}: not a readable image; remove the file from the folder")
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


def as_input(rgb: np.ndarray) -> np.ndarray:
    """Convert (h, w, 3) uint8 to (1, 3, h, w) float32 in 0..1."""
    return np.ascontiguousarray(rgb.transpose(2, 0, 1)[None], np.float32) / np.float32(255)


def load_text_embeddings(path: Path) -> TextEmbeddings:
    """Return the embeddings of `PROMPTS` that a vocabulary .npz (`names`, `emb`) has."""
    try:
        words, rows = load_vocabulary(path)
    except PromptError as error:
        raise ExportError(str(error)) from None
    index = {word: row for row, word in enumerate(words)}
    chosen = [word for word in PROMPTS.split(",") if word in index]
    if not chosen:
        raise ExportError(
            f"--vocabulary {path}: has none of the usual targets, such as chair; give another file"
        )
    return TextEmbeddings(tuple(chosen), rows[[index[word] for word in chosen]])
