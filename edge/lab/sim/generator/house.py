"""A furnished house for every seed.

    house = generated_house(7)

Seeds below `HELD_OUT` are for tuning, the others for evaluation. The houses come from the tables in
`layout` and `contents` only, not from ProcTHOR or another data set.
"""

from __future__ import annotations

from edge.config import Config, WorldGenerated
from edge.lab.sim.boxworld import BoxWorld
from edge.lab.sim.generator.contents import FLOOR_COLORS, FLOORS, WALL_COLORS
from edge.lab.sim.generator.furnish import PlacedItem, RoomFurnisher
from edge.lab.sim.generator.layout import WALL_M, WallSegment, draw_layout
from edge.lab.sim.generator.rng import PortableRng
from edge.lab.sim.house import House, HouseObject, Opening, Room, Wall, build_house

HELD_OUT = 1000  # first seed that is for evaluation only
_RNG_KEY = 12  # separates these random numbers from others with the same seed
_DOOR_HEIGHT_M = 2.05


def load_generated(section: WorldGenerated, config: Config) -> BoxWorld:
    """Return the house of a seed, for the configured robot and camera."""
    return build_house(generated_house(section.seed), config)


def generated_house(seed: int) -> House:
    """Return a house of 4 to 10 rooms, the same on every computer for a seed.

    Doors are at least 0.8 m wide. A robot of radius 0.25 m can reach every room and every object. A
    room's name starts with its kind (`layout.KINDS`).

    Example:
        >>> generated_house(7).name
        'generated-7'
    """
    rng = PortableRng(_RNG_KEY, seed)
    layout = draw_layout(rng)
    rooms, objects, starts = [], [], []
    for k, room in enumerate(layout.rooms):
        doors = [door for door in layout.doors if k in door.rooms]
        furnisher = RoomFurnisher(rng, room.kind, room.rect, doors)
        objects += furnisher.furnish()
        starts.append(furnisher.draw_start())
        r, kind = room.rect, room.kind
        rooms.append(
            Room(name=f"{kind} {k}", rect=(r.x0, r.y0, r.x1, r.y1), floor=rng.pick(FLOORS[kind]),
                 color=_paint(rng, FLOOR_COLORS))
        )  # fmt: skip
    return House(
        name=f"generated-{seed}",
        start=rng.pick(starts),
        wall_height_m=round(rng.between(2.45, 2.9), 2),
        wall_thickness_m=WALL_M,
        rooms=tuple(rooms),
        walls=tuple(_wall(rng, segment) for segment in layout.walls),
        objects=tuple(_house_object(placed) for placed in objects),
    )


def _wall(rng: PortableRng, s: WallSegment) -> Wall:
    """Return a segment of the plan as a wall of the house format, in a random colour."""
    openings: tuple[Opening, ...] = ()
    if s.door is not None:
        at_m = (s.door.x_m - s.x0) + (s.door.y_m - s.y0)  # one of the two is 0
        openings = (Opening(at_m=round(at_m, 2), width_m=s.door.width_m, height_m=_DOOR_HEIGHT_M),)
    color = _paint(rng, WALL_COLORS)
    return Wall(start=(s.x0, s.y0), end=(s.x1, s.y1), color=color, openings=openings)


def _house_object(placed: PlacedItem) -> HouseObject:
    """Return a placed object in the house format."""
    return HouseObject(
        category=placed.category,
        at=(placed.x_m, placed.y_m),
        z_m=placed.z_m,
        yaw_deg=(0.0, 90.0, 180.0, -90.0)[placed.quarter],  # by number of quarter turns
        size=placed.size_m,
        color=placed.color,
    )


def _paint(rng: PortableRng, colors: tuple[tuple[int, int, int], ...]) -> tuple[float, ...]:
    """Return one of the colours, a little lighter or darker."""
    shade = rng.between(0.85, 1.05)
    return tuple(round(min(max(v * shade, 5.0), 250.0), 1) for v in rng.pick(colors))
