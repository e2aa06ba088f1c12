"""Image preparation for the vision encoders of published models, by their own configuration.

There is one function for each supported `image_processor_type` of `preprocessor_config.json`; see
`FAMILIES`. Sizes, means and other settings are read from that file. Each function computes the same
as the processor of that name in transformers, so that a model gets images as in its training.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from edge.perception.runtime.model_file import ModelError
from edge.perception.scoring.vlm.files import ModelFiles
from edge.text import bounded_repr

MAX_EDGE_PX = 4096
"""Longest side of an image, also if Idefics3's processor or an invalid configuration wants more."""
_MAX_FRAMES = 16  # limit of `temporal_patch_size`


class PreparedImage(NamedTuple):
    """A prepared image.

    Attributes:
        feeds: arrays for the vision encoder, by the input names that it may have.
        text: replaces the image token in the prompt.
        grid: (time, rows, columns), numbers of the image's tokens, for a model with 3-D positions
            (M-RoPE); else None.
    """

    feeds: dict[str, np.ndarray]
    text: str
    grid: tuple[int, int, int] | None


Prepare = Callable[[np.ndarray], PreparedImage]
"""Prepares an image, (h, w, 3) uint8 RGB."""


def make_prepare(files: ModelFiles, image_token: str, most_tokens: int) -> Prepare:
    """Return the function that prepares a model's images.

    Raises:
        ModelError: the processor is not supported, or its configuration lacks something.
    """
    settings = files.image or {}
    kind = str(settings.get("image_processor_type", "")).removesuffix("Fast")
    if kind not in FAMILIES:
        raise ModelError(
            f"{files.folder}: model {files.name}: image_processor_type {bounded_repr(kind, 60)} is "
            f"not supported (choices: {', '.join(FAMILIES)})"
        )
    try:
        return FAMILIES[kind](settings, files, image_token, most_tokens)
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(
            f"{files.folder}: model {files.name}: its image processor's configuration is "
            f"incomplete or invalid: {error}"
        ) from None


def _resize(rgb: np.ndarray, size_wh: tuple[int, int], resample: Image.Resampling) -> np.ndarray:
    """Resize with Pillow, whose filter numbers the configurations use."""
    if (rgb.shape[1], rgb.shape[0]) == size_wh:
        return rgb
    return np.asarray(Image.fromarray(rgb).resize(size_wh, resample))


class _Normalise:
    """Converts pixels, (h, w, 3) uint8, to the encoder's numbers, (3, h, w) float32.

    Raises:
        KeyError, ValueError: mean or standard deviation are missing or invalid.
    """

    def __init__(self, settings: dict[str, Any]) -> None:
        scale = (
            float(settings.get("rescale_factor", 1 / 255))
            if settings.get("do_rescale", True)
            else 1.0
        )
        mean, std = np.zeros(3, np.float32), np.ones(3, np.float32)
        if settings.get("do_normalize", True):
            mean = np.asarray(settings["image_mean"], np.float32)
            std = np.asarray(settings["image_std"], np.float32)
        if mean.shape != (3,) or std.shape != (3,) or not std.all():
            raise ValueError("image_mean and image_std must be three numbers each, no std 0")
        self._scale, self._shift = (scale / std).astype(np.float32), (mean / std).astype(np.float32)

    def __call__(self, rgb: np.ndarray) -> np.ndarray:
        return (rgb.astype(np.float32) * self._scale - self._shift).transpose(2, 0, 1)


def _size(settings: dict[str, Any], key: str, most: int, default: int | None = None) -> int:
    """Return a setting that must be an integer of 1 to `most`; raise KeyError or ValueError."""
    found = int(settings[key] if default is None else settings.get(key, default))
    if not 1 <= found <= most:
        raise ValueError(f"{key} is {found}, expected 1 to {most}")
    return found


def _idefics3(
    settings: dict[str, Any], files: ModelFiles, image_token: str, most_tokens: int
) -> Prepare:
    """Prepare images for Idefics3 and SmolVLM: one square of the entire image, and tiles."""
    side = _size(settings["max_image_size"], "longest_edge", MAX_EDGE_PX)
    longest = min(_size(settings["size"], "longest_edge", 1 << 30), MAX_EDGE_PX)
    resample = Image.Resampling(settings.get("resample", 1))
    normalise = _Normalise(settings)
    per_square = _size(files.processor, "image_seq_len", 1 << 30, 169)  # tokens of a square
    _check_limit(most_tokens, per_square)
    most_squares = most_tokens // per_square if settings.get("do_image_splitting", True) else 1
    # Texts of Idefics3's prompt: around each square, before the entire image, and of one square.
    around, overview, square_tokens = (
        "<fake_token_around_image>", "<global-img>", image_token * per_square
    )  # fmt: skip

    def prepare(rgb: np.ndarray) -> PreparedImage:
        edge = longest  # shrunk until the tiles have at most `most_tokens`
        while edge > side and 1 + math.prod(_tiling(rgb, edge, side)) > most_squares:
            edge = (math.ceil(edge / side) - 1) * side
        columns, rows = _tiling(rgb, edge, side)
        squares, text = [], ""  # images of the squares, and the prompt's text for the tiles
        # Without tiles, transformers enlarges the image and shrinks it again; skip that.
        if columns * rows > 1:
            rgb = _resize(
                _resize(rgb, _to_longest(rgb, edge), resample),
                (columns * side, rows * side),
                resample,
            )
            for r, c in np.ndindex(rows, columns):
                squares.append(rgb[r * side : (r + 1) * side, c * side : (c + 1) * side])
                end_of_row = "\n" if c + 1 == columns else ""
                text += f"{around}<row_{r + 1}_col_{c + 1}>{square_tokens}{end_of_row}"
            text += "\n"
        squares.append(_resize(rgb, (side, side), resample))
        pixels = np.stack([normalise(square) for square in squares])[None]
        mask = np.ones((1, len(squares), side, side), bool)
        feeds = {"pixel_values": pixels, "pixel_attention_mask": mask}
        return PreparedImage(feeds, f"{text}{around}{overview}{square_tokens}{around}", None)

    return prepare


def _check_limit(most_tokens: int, least: int) -> None:
    """Raise ValueError if the smallest image has more tokens than the card allows."""
    if most_tokens < least:
        raise ValueError(
            f"the smallest image takes {least} tokens, but image_tokens of the card is "
            f"{most_tokens}; raise image_tokens"
        )


def _to_longest(rgb: np.ndarray, longest: int) -> tuple[int, int]:
    """Return (width, height) of the scaled image: longer side `longest`, shorter side even."""
    height, width = rgb.shape[:2]
    longest = min(longest, MAX_EDGE_PX)
    shorter = int(longest * min(width, height) / max(width, height))
    shorter = max(1, shorter + shorter % 2)
    return (longest, shorter) if width >= height else (shorter, longest)


def _tiling(rgb: np.ndarray, longest: int, side: int) -> tuple[int, int]:
    """Return (columns, rows) of tiles of `side` for an image scaled to `longest`.

    The longer side has as many tiles as cover it. The shorter side then follows from the scaled
    image's aspect ratio.
    """
    width, height = _to_longest(rgb, longest)
    long, short = max(width, height), min(width, height)
    most = math.ceil(long / side)
    least = max(1, math.ceil(int(most * side * short / long) / side))
    return (most, least) if width >= height else (least, most)


def _qwen2_vl(
    settings: dict[str, Any], files: ModelFiles, image_token: str, most_tokens: int
) -> Prepare:
    """Prepare images for Qwen2-VL: patches at about the image's own size, merged by the encoder."""
    patch, merge = (_size(settings, key, MAX_EDGE_PX) for key in ("patch_size", "merge_size"))
    frames = _size(settings, "temporal_patch_size", _MAX_FRAMES, 2)
    resample = Image.Resampling(settings.get("resample", 3))
    if patch * merge > MAX_EDGE_PX:
        raise ValueError(
            f"patch_size times merge_size is {patch * merge}, expected 1 to {MAX_EDGE_PX}"
        )
    size = settings.get("size") or {}
    least = int(settings.get("min_pixels") or size["shortest_edge"])
    most = int(settings.get("max_pixels") or size["longest_edge"])
    per_token_px = (patch * merge) ** 2
    _check_limit(most_tokens, math.ceil(least / per_token_px))
    if max(least, per_token_px) > MAX_EDGE_PX**2 or most < per_token_px:
        raise ValueError(
            f"expected min_pixels of at most {MAX_EDGE_PX**2} and max_pixels of at least "
            f"{per_token_px}, got min_pixels {least} and max_pixels {most}"
        )
    most = min(most, most_tokens * per_token_px, MAX_EDGE_PX**2)
    normalise = _Normalise(settings)

    def prepare(rgb: np.ndarray) -> PreparedImage:
        height, width = smart_resize(rgb.shape[0], rgb.shape[1], patch * merge, least, most)
        planes = normalise(_resize(rgb, (width, height), resample))
        rows, columns = height // patch, width // patch
        # A still image is a film of equal frames.
        film = np.broadcast_to(planes, (frames, *planes.shape))
        # One row for each patch; the patches that the encoder merges into one token come together.
        blocks = film.reshape(
            1, frames, 3, rows // merge, merge, patch, columns // merge, merge, patch
        ).transpose(0, 3, 6, 4, 7, 2, 1, 5, 8)
        patches = np.ascontiguousarray(blocks).reshape(rows * columns, -1)
        patch_grid = np.array([[1, rows, columns]], np.int64)  # time, rows, columns
        feeds = {"pixel_values": patches, "image_grid_thw": patch_grid, "grid_thw": patch_grid}
        token_grid = (1, rows // merge, columns // merge)
        return PreparedImage(feeds, image_token * math.prod(token_grid), token_grid)

    return prepare


def smart_resize(height: int, width: int, factor: int, least: int, most: int) -> tuple[int, int]:
    """Return a size in multiples of `factor`, nearly in proportion, with `least` to `most` pixels.

    >>> smart_resize(480, 640, 28, 3136, 1003520), smart_resize(480, 640, 28, 3136, 78400)
    ((476, 644), (224, 308))
    """
    h, w = (max(factor, round(side / factor) * factor) for side in (height, width))
    if h * w > most:
        shrink = math.sqrt(height * width / most)
        h, w = (max(factor, math.floor(s / shrink / factor) * factor) for s in (height, width))
    elif h * w < least:
        grow = math.sqrt(least / (height * width))
        h, w = (math.ceil(side * grow / factor) * factor for side in (height, width))
    return h, w


FAMILIES: dict[str, Callable[[dict[str, Any], ModelFiles, str, int], Prepare]] = {
    "Idefics3ImageProcessor": _idefics3,
    "SmolVLMImageProcessor": _idefics3,
    "Qwen2VLImageProcessor": _qwen2_vl,
}


def positions(ids: np.ndarray, image_id: int, grid: tuple[int, int, int] | None) -> np.ndarray:
    """Return the positions of tokens for the rotary embedding, (3, n) int64: time, row, column.

    A text token's three positions are equal, one more than those of the token before. The tokens of
    an image with a grid have their positions in the grid. The text after the image continues after
    the largest position (M-RoPE, Qwen2-VL 2.1).

    >>> positions(np.array([5, 9, 9, 9, 9, 6]), 9, (1, 2, 2)).tolist()
    [[0, 1, 1, 1, 1, 3], [0, 1, 1, 2, 2, 3], [0, 1, 2, 1, 2, 3]]
    """
    n = len(ids)
    places = np.tile(np.arange(n, dtype=np.int64), (3, 1))
    image_at = np.flatnonzero(ids == image_id) if grid is not None else ids[:0]
    if len(image_at):
        first, count = int(image_at[0]), len(image_at)
        places[:, first : first + count] = first + np.indices(grid).reshape(3, -1)
        places[:, first + count :] = np.arange(n - first - count) + first + max(grid)
    return places
