"""Made pictures of painted objects in other light: a street, a room and a yard.

`python tests/tasks/painted_scenes.py` prints how many of 30 objects get the right colour.
"""

from __future__ import annotations

import numpy as np

from edge.tasks.scene.captions import compose_captions
from edge.types import Detections, Observation

RGB = tuple[int, int, int]

PAINTS: tuple[tuple[str, RGB], ...] = (
    ("black", (34, 34, 38)), ("black", (20, 20, 20)),
    ("gray", (128, 128, 128)), ("gray", (118, 121, 126)),
    ("white", (240, 240, 240)), ("white", (232, 230, 224)),
    ("red", (190, 40, 36)), ("red", (200, 20, 20)), ("red", (170, 28, 44)),
    ("orange", (250, 130, 20)), ("orange", (236, 140, 38)), ("orange", (228, 112, 30)),
    ("yellow", (240, 220, 30)), ("yellow", (228, 190, 40)), ("yellow", (238, 208, 62)),
    ("green", (40, 110, 66)), ("green", (30, 160, 40)), ("green", (46, 120, 60)),
    ("blue", (40, 82, 170)), ("blue", (30, 60, 200)), ("blue", (44, 90, 170)),
    ("purple", (120, 40, 200)), ("purple", (122, 60, 172)), ("purple", (96, 40, 150)),
    ("pink", (250, 90, 180)), ("pink", (240, 120, 190)), ("pink", (226, 80, 160)),
    ("brown", (110, 60, 20)), ("brown", (124, 76, 40)), ("brown", (92, 54, 28)),
)  # fmt: skip
"""Thirty objects: the name of the colour, and the paint in full light."""
LIGHTS: dict[str, tuple[float, float, float]] = {
    "full": (1.0, 1.0, 1.0), "30 %": (0.3, 0.3, 0.3), "warm": (1.0, 0.8, 0.55),
    "cool": (0.65, 0.85, 1.0), "warm, 40 %": (0.4, 0.32, 0.22), "cool, 40 %": (0.26, 0.34, 0.4),
}  # fmt: skip
"""Light → its factors on red, green and blue."""
PLACES: dict[str, tuple[RGB, RGB, RGB]] = {
    "street": ((150, 190, 240), (84, 86, 90), (176, 174, 168)),  # sky, road, sidewalk
    "room": ((214, 206, 192), (150, 104, 62), (226, 226, 222)),  # wall, wooden floor, door
    "yard": ((78, 120, 66), (96, 132, 74), (150, 148, 142)),  # hedge, lawn, path
}
"""Place → the colours of its upper half, its lower half, and a strip in the lower half."""
H, W = 96, 128
BOX = np.array([[44, 36, 84, 66]], np.float32)


def picture(place: str, paint: RGB, light: str, shaded: bool = False) -> np.ndarray:
    """Return a picture (H, W, 3) uint8 of a painted object with dark windows and tyres.

    `shaded`: the light falls on the middle of the picture only, the rest is in full light.
    """
    rgb = np.zeros((H, W, 3))
    upper, lower, strip = PLACES[place]
    rgb[: H // 2], rgb[H // 2 :], rgb[H // 2 + 30 : H // 2 + 40] = upper, lower, strip
    x0, y0, x1, y1 = BOX[0].astype(int)
    rgb[y0:y1, x0:x1] = paint
    rgb[y0:y1, x0:x1] *= np.linspace(1.0, 0.75, y1 - y0)[:, None, None]  # its sides are darker
    rgb[y0 + 4 : y0 + 9, x0 + 4 : x1 - 4] = (44, 52, 60)  # windows
    rgb[y1 - 4 : y1, x0 + 4 : x0 + 12] = rgb[y1 - 4 : y1, x1 - 12 : x1 - 4] = (24, 24, 26)  # tyres
    lit = np.ones((H, W, 1)) * np.array(LIGHTS[light])
    if shaded:
        lit[:, :24] = lit[:, -24:] = 1.0
    noise = np.random.default_rng(0).normal(0.0, 2.0, rgb.shape)
    return np.clip(np.rint(rgb * lit + noise), 0, 255).astype(np.uint8)


def colour_in(rgb: np.ndarray) -> str:
    """Return the colour that the caption of the object gives it."""
    seen = Observation(0, 0, np.eye(4), rgb=rgb)
    found = Detections(seen, BOX, np.ones(1, np.float32), np.zeros(1, np.int32), ("car",))
    return compose_captions(found)[0].removesuffix("car").strip()


def results(place: str, light: str, shaded: bool = False) -> list[tuple[str, str]]:
    """Return the true and the given colour of each object."""
    return [(name, colour_in(picture(place, paint, light, shaded))) for name, paint in PAINTS]


def table() -> str:
    """Return the number of right colours of 30, by place and light."""
    lines = [f"{'right of 30':14}" + "".join(f"{light:>12}" for light in LIGHTS)]
    for place in PLACES:
        for shaded in (False, True):
            row = [
                sum(true == given for true, given in results(place, light, shaded))
                for light in LIGHTS
            ]
            name = f"{place}, part" if shaded else place
            lines.append(f"{name:14}" + "".join(f"{n:12}" for n in row))
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
