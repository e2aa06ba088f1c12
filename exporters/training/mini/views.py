"""Images of random houses with the objects that each shows, to train and evaluate the detector.

    frames = make_frames(range(3000), PER_HOUSE, folder=Path("..."), workers=2)

An image takes 246 kB, so all are stored as one array on disk.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from edge.config import parse
from edge.geometry import SE2, CameraModel, se3, to_optical
from edge.host.files import replace_atomically
from edge.lab.sim import assemblies, generator, kernels
from edge.lab.sim.boxworld import BoxWorld
from edge.lab.sim.house import House, build_house
from edge.perception.detection import kernels as detection_kernels
from exporters.files import ExportError
from exporters.training.mini import houses, looks
from exporters.training.mini.houses import Appearance, extent_m, random_house

HEIGHT_PX, WIDTH_PX = 256, 320  # of every image
PER_HOUSE = 11
"""Images of each house to train on."""
MIN_PIXELS = 40
"""Objects with fewer visible pixels are not listed."""
CLEARANCE_M = 0.28
"""Least free space around the camera."""
COLORED = 0.15
"""The colour of an object is known only if at least this share of its visible pixels has it. A
plant, for example, has its colour only at the pot, which may be hidden."""
_PREVIEW = 4  # the worth of a view is computed in an image smaller by this factor
_PREVIEW_PIXELS = 8  # an object with more pixels in the smaller image counts
_CANDIDATES = 3  # random views of which mostly the best is taken
_SOURCES = (
    *(Path(path) for path in (houses.__file__, looks.__file__, __file__)),
    *sorted(Path(assemblies.__file__).parent.glob("*.py")),
    *sorted(Path(generator.__file__).parent.glob("*.py")),
)
"""Code that the images depend on; if it changes, they are rendered again."""

OBJECT = np.dtype(
    [
        ("category", np.uint8),
        ("color", np.int8, 1 + len(looks.COLORS)),
        ("size", np.int8, 1 + len(looks.SIZES)),
        ("box", np.float32, 4),
        ("pixels", np.int32),
        ("visible", np.float32),
    ]
)
"""One object in an image.

category: index into `looks.CATEGORIES`, from 1.
color, size: as in `houses.Appearance`; one answer for each word of `looks` (yes, no or unsure).
    Entry 0 is the answer for no word.
box: x0 y0 x1 y1 of the visible pixels; x1 and y1 are exclusive.
pixels: number of visible pixels.
visible: their share of the pixels that it would have if nothing stood in front of it.
"""


@dataclass(frozen=True, slots=True)
class Frames:
    """Images and the objects that they show.

    Attributes:
        rgb: (n, 256, 320, 3) uint8.
        objects: (m,) `OBJECT`, image after image.
        start: (n + 1,) int64; image i shows objects[start[i]:start[i + 1]].
    """

    rgb: np.ndarray
    objects: np.ndarray
    start: np.ndarray

    def __len__(self) -> int:
        return len(self.rgb)

    def objects_in(self, frame: int) -> np.ndarray:
        """Return the objects of one image, (o,) `OBJECT`."""
        return self.objects[self.start[frame] : self.start[frame + 1]]


@dataclass(frozen=True, slots=True)
class _Camera:
    """A camera, and the (4, 4) pose of its optical frame."""

    model: CameraModel
    T_map_camera: np.ndarray


def is_inside_image(objects: np.ndarray) -> np.ndarray:
    """Return (o,) bool: True if the object touches no edge of the image, so its size is known."""
    box = objects["box"]
    return (box[:, :2] > 0).all(1) & (box[:, 2:] < (WIDTH_PX, HEIGHT_PX)).all(1)


def make_frames(seeds: Sequence[int], per_house: int, folder: Path, workers: int = 1) -> Frames:
    """Return images of the houses of these seeds; they are stored in `folder` and reused.

    Several processes may do this in one folder: each renders to its own file.

    Raises:
        ExportError: the images do not fit on the disk.
    """
    name = f"{seeds[0]}-{seeds[-1]}x{per_house}-{_digest(seeds, per_house)}"
    images_file, objects_file = folder / f"{name}.u8", folder / f"{name}.npz"
    shape = (len(seeds) * per_house, HEIGHT_PX, WIDTH_PX, 3)
    if not objects_file.is_file():
        with replace_atomically(images_file) as part:
            _reserve(part, math.prod(shape))
            rows = _render(seeds, per_house, part, shape, workers)
        start = np.concatenate([[0], np.cumsum([len(objects) for objects in rows])])
        with replace_atomically(objects_file) as part:  # written last: then the images are complete
            np.savez(part, objects=np.concatenate(rows), start=start.astype(np.int64))
    with np.load(objects_file) as data:
        return Frames(np.memmap(images_file, np.uint8, "r", shape=shape), data["objects"],
                      data["start"])  # fmt: skip


def _digest(seeds: Sequence[int], per_house: int) -> str:
    """Return eight hex digits of everything that the images depend on."""
    digest = hashlib.sha256(repr((list(seeds), per_house)).encode())
    for path in _SOURCES:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


def _reserve(path: Path, size: int) -> None:
    """Grow an empty file to `size` bytes, and allocate them on the disk."""
    try:
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, size)
    except OSError as error:
        raise ExportError(
            f"{path.parent}: no room for {size / 1e9:.1f} GB of images ({error.strerror}); "
            "free some space, or give --out on another disk"
        ) from None


def _render(
    seeds: Sequence[int], per_house: int, images_file: Path, shape: tuple[int, ...], workers: int
) -> list[np.ndarray]:
    """Fill the file with the images of all houses; return the objects of each image."""
    jobs = [(images_file, shape, k * per_house, seed, per_house) for k, seed in enumerate(seeds)]
    if workers > 1:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            made = list(pool.map(_write_house, jobs, chunksize=8))
    else:
        made = [_write_house(job) for job in jobs]
    return [objects for house in made for objects in house]


def _write_house(job: tuple[Path, tuple[int, ...], int, int, int]) -> list[np.ndarray]:
    """Write the images of one house into the file; return the objects of each image.

    A job is the file, the shape of its array, the first index, the seed, and the number of images.
    """
    images_file, shape, first, seed, count = job
    rgb = np.memmap(images_file, np.uint8, "r+", shape=shape)
    return render_house(seed, count, rgb[first : first + count])


def render_house(seed: int, count: int, out_rgb: np.ndarray) -> list[np.ndarray]:
    """Fill `out_rgb` (count, 256, 320, 3) with images of one house; return the objects of each."""
    house, appearances = random_house(seed)
    world = build_house(house, parse({"perception": {"detector": {"kind": "sim"}}}))
    rng = np.random.default_rng([8, seed])
    depth = np.empty((HEIGHT_PX, WIDTH_PX), np.float32)
    ids = np.empty((HEIGHT_PX, WIDTH_PX), np.uint16)
    has_own_color, found = _has_own_color(house, world), []
    for k in range(count):
        camera = _choose_view(world, extent_m(house), appearances, rng)
        world.render(camera.model, camera.T_map_camera, out_rgb[k], depth, ids)
        found.append(_visible_objects(world, appearances, has_own_color, camera, ids, depth))
    return found


def _has_own_color(house: House, world: BoxWorld) -> np.ndarray:
    """Return (primitives,) bool: True if a primitive has its object's colour, or a derived one."""
    has_own_color = np.zeros(len(world.owner), bool)
    for k, item in enumerate(house.objects, 1):
        rows = assemblies.CATEGORIES[item.category].rows
        materials = [material for _shape, _center, _size, material, *_texture in rows]
        has_own_color[world.owner == k] = [m in ("main", "dark", "light") for m in materials]
    return has_own_color


def _random_camera(
    world: BoxWorld, extent: tuple[float, float], rng: np.random.Generator
) -> _Camera:
    """Return a camera of random height, field of view and pose inside the house."""
    rows, cols = np.nonzero(world.plan.clearance_m > CLEARANCE_M)
    while True:
        pick = int(rng.integers(len(rows)))
        x, y = world.plan.grid.centres_m(rows[pick], cols[pick]).tolist()
        # The plan has a free margin around the house.
        if 0.3 < x < extent[0] - 0.3 and 0.3 < y < extent[1] - 0.3:
            break
    z = 0.6 if rng.random() < 0.6 else float(rng.uniform(0.35, 1.1))
    hfov = 75.0 if rng.random() < 0.6 else float(rng.uniform(60, 95))
    pitch = math.radians(rng.normal(5.0, 5.0))
    model = CameraModel.from_hfov(WIDTH_PX, HEIGHT_PX, math.radians(hfov))
    pose = SE2(x, y, float(rng.uniform(-math.pi, math.pi)))
    return _Camera(model, pose.matrix() @ to_optical(se3(0.1, 0.0, z, pitch_rad=pitch)))


def _choose_view(
    world: BoxWorld,
    extent: tuple[float, float],
    appearances: list[Appearance],
    rng: np.random.Generator,
) -> _Camera:
    """Return mostly the best of a few random views: with many objects, and several of a kind."""
    cameras = [_random_camera(world, extent, rng) for _ in range(_CANDIDATES)]
    worth = [_worth(world, appearances, camera) for camera in cameras]
    if rng.random() < 0.25:  # sometimes any view that shows more than a wall
        return next((c for c, w in zip(cameras, worth, strict=True) if w > 0), cameras[0])
    return cameras[int(np.argmax(worth))]


def _worth(world: BoxWorld, appearances: list[Appearance], camera: _Camera) -> float:
    """Return the number of categories in a view, plus 2.5 for each further object of a category."""
    h, w = HEIGHT_PX // _PREVIEW, WIDTH_PX // _PREVIEW
    m, depth, prim = camera.model, np.empty((h, w), np.float32), np.empty((h, w), np.int32)
    kernels.render_depth(
        world.shape, world.geometry, camera.T_map_camera, m.fx_px / _PREVIEW, m.fy_px / _PREVIEW,
        m.cx_px / _PREVIEW, m.cy_px / _PREVIEW, depth, prim,
    )  # fmt: skip
    # `prim` has the primitive at each pixel, -1 for none. `owner` has the object of each primitive,
    # from 1; 0 for the building.
    count = np.bincount(world.owner[prim[prim >= 0]], minlength=len(appearances) + 1)[1:]
    seen = [appearances[k].category for k in np.flatnonzero(count > _PREVIEW_PIXELS)]
    return len(set(seen)) + 2.5 * (len(seen) - len(set(seen)))


def _visible_objects(
    world: BoxWorld,
    appearances: list[Appearance],
    has_own_color: np.ndarray,
    camera: _Camera,
    ids: np.ndarray,
    depth: np.ndarray,
) -> np.ndarray:
    """Return the objects that an image shows, (o,) `OBJECT`."""
    n = len(appearances)
    box, pixels = np.empty((n, 4), np.int32), np.empty(n, np.int32)
    detection_kernels.object_boxes(ids, depth, box, pixels, np.empty(n, np.float32))
    scratch_depth = np.empty((HEIGHT_PX, WIDTH_PX), np.float32)
    # Primitive at each pixel, -1 for none; `world.owner` is the object of each primitive, from 1.
    prim, m = np.empty((HEIGHT_PX, WIDTH_PX), np.int32), camera.model
    lens = (camera.T_map_camera, m.fx_px, m.fy_px, m.cx_px, m.cy_px)
    # Pixels of each object in its colour: `ids` distinguishes objects, but not their primitives.
    kernels.render_depth(world.shape, world.geometry, *lens, scratch_depth, prim)
    seen = np.bincount(prim[prim >= 0], minlength=len(world.owner))
    colored = np.bincount(world.owner, seen * has_own_color, minlength=n + 1)[1:]
    objects = np.zeros(int((pixels >= MIN_PIXELS).sum()), OBJECT)
    for item, k in zip(objects, np.flatnonzero(pixels >= MIN_PIXELS), strict=True):
        # Render the object alone, to count its pixels without occlusion.
        is_own = world.owner == k + 1
        own = (world.shape[is_own], world.geometry[is_own])
        kernels.render_depth(*own, *lens, scratch_depth, prim)
        item["category"], item["size"] = appearances[k].category, appearances[k].size
        is_color_known = colored[k] >= COLORED * pixels[k]
        item["color"] = appearances[k].color if is_color_known else looks.unsure_color()
        item["box"], item["pixels"] = box[k], pixels[k]
        item["visible"] = pixels[k] / max(1, int((prim >= 0).sum()))
    return objects
