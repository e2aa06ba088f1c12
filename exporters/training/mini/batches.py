"""Training batches for the small detector: random crops of images, and phrases about each.

Some phrases are true of an object in the image, others nearly true.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from exporters.training.mini import looks
from exporters.training.mini.loss import Labels
from exporters.training.mini.views import HEIGHT_PX, WIDTH_PX, Frames, is_inside_image

PAD = 114
"""Grey value around an image that does not fill the crop."""
PHRASES = 24
"""Number of phrases about an image, without the plain ones (a category alone)."""
NAMED = 9
"""Largest number of objects of an image that get a true phrase each. The other phrases are random,
and most of them are wrong."""
HARD_SHARE = 0.6
"""Share of the random phrases that name a category in the image, with a random colour or size."""
MIN_SIDE_PX = 8.0
"""Smaller objects (in an image of 320 columns) are not taught."""
MIN_VISIBLE = 0.25
"""Objects with a smaller visible share are not taught."""
MIN_COMPLETE = 0.9
"""If a smaller share of an object is in the crop, its size is unknown, and is not taught."""
LEAST_IN_CROP = 0.3
"""If a smaller share of an object's box is in the crop, the object is not taught."""
MAX_OBJECTS = 32
"""Largest number of objects of an image."""
ZOOM = (0.8, 1.6)
"""Range of the scale of a crop, relative to the entire image."""
AHEAD = 6
"""Batches that are made in advance."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Images with phrases and the right answers.

    Attributes:
        images: (b, 3, h, w) uint8.
        phrases: (b, k, 3) int64, see `looks`.
        labels: objects of the images, and the answers to the phrases.
    """

    images: Tensor
    phrases: Tensor
    labels: Labels


def cut(
    rgb: np.ndarray, boxes: np.ndarray, hw: tuple[int, int], rng: np.random.Generator | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Resize an image (256, 320, 3) uint8; with `rng`, take a random crop, sometimes mirrored.

    Returns:
        The image (h, w, 3) uint8, boxes (o, 4) in it, and the share of each box that is left.
    """
    h, w = hw
    # The crop shows the part `view_w` by `view_h` at x0, y0 of the image. The part may be larger
    # than the image, which then gets a border.
    zoom = 1.0 if rng is None else float(np.exp(rng.uniform(*np.log(ZOOM))))
    base = min(h / HEIGHT_PX, w / WIDTH_PX)
    scale = base * zoom
    view_w, view_h = w / scale, h / scale
    fx, fy = (0.5, 0.5) if rng is None else rng.random(2)
    x0, y0 = fx * (WIDTH_PX - view_w), fy * (HEIGHT_PX - view_h)
    u0, u1, left, right = _span(x0, view_w, WIDTH_PX, w)
    v0, v1, top, bottom = _span(y0, view_h, HEIGHT_PX, h)
    out = np.full((h, w, 3), PAD, np.uint8)
    interpolation = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    out[top:bottom, left:right] = cv2.resize(
        rgb[v0:v1, u0:u1], (right - left, bottom - top), interpolation=interpolation
    )
    # Scale of x0, y0, x1, y1; by cell sizes after rounding, so that boxes match the pixels.
    s = np.array([(right - left) / (u1 - u0), (bottom - top) / (v1 - v0)] * 2, np.float32)
    moved = (boxes - np.array([u0, v0, u0, v0], np.float32)) * s
    moved += np.array([left, top, left, top], np.float32)
    full = (moved[:, 2] - moved[:, 0]) * (moved[:, 3] - moved[:, 1])
    moved[:, [0, 2]] = moved[:, [0, 2]].clip(left, right)
    moved[:, [1, 3]] = moved[:, [1, 3]].clip(top, bottom)
    share = (moved[:, 2] - moved[:, 0]) * (moved[:, 3] - moved[:, 1]) / np.maximum(full, 1e-6)
    if rng is not None and rng.random() < 0.5:
        out = out[:, ::-1]
        moved[:, [0, 2]] = w - moved[:, [2, 0]]
    return out, moved, share


def _span(start: float, length: float, full: int, size: int) -> tuple[int, int, int, int]:
    """Return first and last pixel of a view along one axis: in the image, then in the crop.

    The view has this start and length in the image, which is `full` long; the crop has `size`
    pixels. The start is negative if the view is larger than the image.
    """
    if length <= full:
        return round(start), min(full, round(start + length)), 0, size
    scale = size / length
    return 0, full, round(-start * scale), round((full - start) * scale)


def sample_phrases(objects: np.ndarray, rng: np.random.Generator, plain: int = 0) -> np.ndarray:
    """Return phrases for an image with these objects.

    Returns:
        (PHRASES + plain, 3) int64, see `looks`: true phrases, then others, then plain ones.
    """
    rows = []
    for k in rng.permutation(len(objects))[:NAMED]:
        o = objects[k]
        # Words that are true of the object; entry 0 stands for no word.
        colors, sizes = (np.flatnonzero(o[name][1:] == looks.YES) for name in ("color", "size"))
        kind = int(rng.integers(4))  # 1: with a colour, 2: with a size, 3: with both
        color = int(rng.choice(colors)) + 1 if kind in (1, 3) and len(colors) else 0
        size = int(rng.choice(sizes)) + 1 if kind in (2, 3) and len(sizes) else 0
        rows.append((int(o["category"]), color, size))
    while len(rows) < PHRASES:
        if len(objects) and rng.random() < HARD_SHARE:
            o = objects[int(rng.integers(len(objects)))]
            kind = int(rng.integers(5))  # 0 and 3: a colour, 1 and 4: a size, 2: both
            color = int(rng.integers(1, 1 + len(looks.COLORS))) if kind != 1 and kind != 4 else 0
            size = int(rng.integers(1, 1 + len(looks.SIZES))) if kind in (1, 2, 4) else 0
            rows.append((int(o["category"]), color, size))
        else:
            color = int(rng.integers(1, 1 + len(looks.COLORS))) if rng.random() < 0.3 else 0
            size = int(rng.integers(1, 1 + len(looks.SIZES))) if rng.random() < 0.3 else 0
            rows.append((int(rng.integers(1, 1 + len(looks.CATEGORIES))), color, size))
    rows += [(int(c) + 1, 0, 0) for c in rng.permutation(len(looks.CATEGORIES))[:plain]]
    return np.array(rows, np.int64)


def make_batch(
    frames: Frames,
    indices: np.ndarray,
    hw: tuple[int, int],
    rng: np.random.Generator,
    plain: int = 0,
) -> Batch:
    """Return a batch."""
    n, k = len(indices), PHRASES + plain
    images = np.empty((n, *hw, 3), np.uint8)
    phrases = np.empty((n, k, 3), np.int64)
    boxes = np.zeros((n, MAX_OBJECTS, 4), np.float32)
    taught = np.zeros((n, MAX_OBJECTS), bool)
    answers = np.zeros((n, MAX_OBJECTS, k), np.int8)
    hard = np.zeros((n, MAX_OBJECTS, k), bool)  # see `Labels`
    min_side = MIN_SIDE_PX * max(0.75, hw[1] / WIDTH_PX)
    for i, index in enumerate(indices):
        objects = frames.objects_in(int(index))
        picture, moved, share = cut(frames.rgb[index], objects["box"], hw, rng)
        images[i] = tint(np.ascontiguousarray(picture), rng)
        side = np.minimum(moved[:, 2] - moved[:, 0], moved[:, 3] - moved[:, 1])
        kept = np.flatnonzero(side > 2.0)[:MAX_OBJECTS]
        objects, moved, share, side = objects[kept], moved[kept], share[kept], side[kept]
        # `objects` is a copy here, because `kept` is an array of indices.
        objects["size"][~is_inside_image(objects) | (share < MIN_COMPLETE), 1:] = looks.UNSURE
        is_taught = (side >= min_side) & (objects["visible"] * share >= MIN_VISIBLE)
        is_taught &= share >= LEAST_IN_CROP
        phrases[i] = sample_phrases(objects[is_taught], rng, plain)
        m = len(objects)
        answers_here = looks.answers(
            objects["category"], objects["color"], objects["size"], phrases[i]
        )
        boxes[i, :m], taught[i, :m], answers[i, :m] = moved, is_taught, answers_here
        same = objects["category"][:, None] == phrases[i][None, :, 0]
        hard[i, :m] = same & (answers_here == looks.NO) & is_taught[:, None]
    most = max(1, int(boxes.any(2).sum(1).max()))  # objects of an image; the rest is padding
    labels = Labels(*(torch.from_numpy(x[:, :most]) for x in (boxes, taught, answers, hard)))
    planes = torch.from_numpy(images).permute(0, 3, 1, 2)
    return Batch(planes, torch.from_numpy(phrases), labels)


def batches(
    frames: Frames, batch: int, steps: list[tuple[tuple[int, int], int]], seed: int, first: int = 0
) -> Iterator[Batch]:
    """Yield the batches from number `first` on, made in advance in a thread.

    Each batch has its own random generator, so a run that continues from a checkpoint gets the same
    batches. `steps` has ((height, width), number of plain phrases) of each.
    """

    def make(step: int) -> Batch:
        """Return the batch of a step."""
        rng = np.random.default_rng([9, seed, step])
        indices = rng.choice(len(frames), batch, replace=len(frames) < batch)
        return make_batch(frames, indices, steps[step][0], rng, steps[step][1])

    ahead: deque[Future[Batch]] = deque()
    pool = ThreadPoolExecutor(1, "batches")
    try:
        for step in range(first, len(steps)):
            ahead.append(pool.submit(make, step))
            if len(ahead) > AHEAD:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def tint(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Change exposure, gamma and white balance of a uint8 image at random."""
    gain = rng.uniform(0.75, 1.2) * rng.uniform(0.95, 1.05, 3)
    # New value of each of the 256 old ones, by channel.
    table = (np.arange(256.0)[:, None] / 255.0) ** rng.uniform(0.85, 1.18) * gain * 255.0
    return cv2.LUT(picture, table.clip(0, 255).astype(np.uint8)[None])


def disturb(images: Tensor, generator: torch.Generator) -> Tensor:
    """Add uneven light, noise and blur: uint8 (b, 3, h, w) → float32 in 0..1 on the same device."""
    b, _, h, w = images.shape

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        """Return uniform random numbers from [low, high)."""
        return low + (high - low) * torch.rand(shape, generator=generator)

    field = torch.nn.functional.interpolate(
        uniform(-1.0, 1.0, b, 1, 3, 3), (h, w), mode="bilinear", align_corners=True
    )
    field = (1.0 + uniform(0.0, 0.22, b, 1, 1, 1) * field) / 255.0
    noise = torch.randn(1, 1, h, w, generator=generator) * uniform(0.0, 0.03, b, 1, 1, 1)
    x = (images * field.to(images.device)).add_(noise.to(images.device))
    if float(torch.rand((), generator=generator)) < 0.25:
        third = b // 3  # the order of the images is random
        x[:third] = torch.nn.functional.avg_pool2d(x[:third], 3, 1, 1)
    return x.clamp_(0.0, 1.0)
