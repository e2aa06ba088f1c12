"""Tables of the furniture of each kind of room: probabilities and places."""

from __future__ import annotations

from dataclasses import dataclass

from edge.lab.sim.generator.layout import BATHROOM, BEDROOM, HALLWAY, KITCHEN, LIVING, OFFICE

SUPPORTS = ("desk", "table", "tv stand", "cabinet", "dresser", "nightstand", "coffee table")
"""Furniture on which other objects are placed."""
ON_TOP = ("laptop", "vase", "microwave", "television", "ball", "box", "plant")
"""Objects that are placed on such furniture."""
USUAL_ON = {"tv stand": "television", "desk": "laptop"}
"""Support → the object that is usually on it."""

# r, g, b, each 0 to 255.
FLOOR_COLORS = ((176, 132, 88), (150, 108, 72), (206, 202, 194), (168, 158, 150), (188, 206, 214),
                (196, 156, 108), (120, 92, 70), (140, 142, 146))  # fmt: skip
WALL_COLORS = ((226, 222, 212), (214, 220, 210), (208, 214, 222), (222, 214, 198), (228, 220, 200),
               (222, 204, 204), (196, 206, 196), (178, 190, 206), (238, 238, 236))  # fmt: skip
# Materials of the floor by kind of room (names as in `house.FLOORS`); a frequent one is repeated.
FLOORS = {
    LIVING: ("wood", "wood", "carpet"), KITCHEN: ("tiles", "tiles", "plain"),
    BEDROOM: ("carpet", "wood"), BATHROOM: ("tiles",), OFFICE: ("wood", "carpet", "plain"),
    HALLWAY: ("wood", "tiles"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class FurnitureRule:
    """Rule for placing objects of one category in rooms of a kind.

    Attributes:
        category: key of `edge.lab.sim.assemblies.CATEGORIES`.
        p: probability that the room gets the object; 1 for a necessary one.
        where: a key of `furnish.PLACES`, such as "wall" (with its back to one) or "on".
        by: categories that it is placed next to, on, or in front of, if `where` needs that. Without
            any of them in the room the object is left out.
        most: largest number of objects by this rule in a room.
        more: probability of another object after each one that was placed.
        gap_m: gap on the floor to the object that it belongs to.
        from_m2: smallest floor area of a room that gets the object.
    """

    category: str
    p: float
    where: str = "wall"
    by: tuple[str, ...] = ()
    most: int = 1
    more: float = 0.5
    gap_m: float = 0.04
    from_m2: float = 0.0


_DINING = (
    FurnitureRule("table", 0.85, "middle", from_m2=9.5),
    FurnitureRule("chair", 1.0, "around", ("table",), most=4, more=0.85),
)
_TELEVISION_SET = (
    FurnitureRule("tv stand", 0.9, "across", ("sofa",)),
    FurnitureRule("television", 0.95, "on", ("tv stand",)),
)

CONTENTS: dict[str, tuple[FurnitureRule, ...]] = {
    LIVING: (
        FurnitureRule("sofa", 1.0, most=2, more=0.25),
        *_TELEVISION_SET,
        FurnitureRule("coffee table", 0.8, "before", ("sofa",), gap_m=0.4),
        FurnitureRule("armchair", 0.65, most=2, more=0.45),
        FurnitureRule("table", 0.6, "middle", from_m2=18.0),
        FurnitureRule("chair", 0.9, "around", ("table",), most=4, more=0.85),
        FurnitureRule("bookshelf", 0.6, most=2, more=0.35),
        FurnitureRule("cabinet", 0.35),
        FurnitureRule("plant", 0.7, "corner", most=2, more=0.35),
        FurnitureRule("lamp", 0.65, "corner"),
        FurnitureRule("rug", 0.55, "floor", ("coffee table", "sofa")),
        FurnitureRule("vase", 0.4, "on", ("coffee table", "cabinet", "table")),
        FurnitureRule("picture", 0.75, "hung", most=3, more=0.5),
        FurnitureRule("ball", 0.12, "anywhere"),
    ),
    KITCHEN: (
        FurnitureRule("refrigerator", 1.0),
        FurnitureRule("oven", 1.0),
        FurnitureRule("sink", 1.0),
        FurnitureRule("cabinet", 0.9, most=3, more=0.6),
        *_DINING,
        FurnitureRule("stool", 0.25, most=2, more=0.6),
        FurnitureRule("washing machine", 0.2),
        FurnitureRule("microwave", 0.85, "on", ("cabinet",)),
        FurnitureRule("trash can", 0.8),
        FurnitureRule("vase", 0.3, "on", ("table",)),
        FurnitureRule("plant", 0.2, "corner"),
        FurnitureRule("picture", 0.25, "hung"),
    ),
    BEDROOM: (
        FurnitureRule("bed", 1.0),
        FurnitureRule("nightstand", 0.9, "beside", ("bed",), most=2, more=0.55),
        FurnitureRule("wardrobe", 0.85),
        FurnitureRule("dresser", 0.55),
        FurnitureRule("desk", 0.25, from_m2=12.0),
        FurnitureRule("chair", 0.9, "before", ("desk",)),
        FurnitureRule("armchair", 0.2),
        FurnitureRule("lamp", 0.5, "corner"),
        FurnitureRule("laptop", 0.6, "on", ("desk",)),
        FurnitureRule("television", 0.2, "on", ("dresser",)),
        FurnitureRule("vase", 0.1, "on", ("dresser", "nightstand")),
        FurnitureRule("rug", 0.4, "floor", ("bed",)),
        FurnitureRule("picture", 0.6, "hung", most=2, more=0.4),
        FurnitureRule("plant", 0.2, "corner"),
        FurnitureRule("backpack", 0.2),
        FurnitureRule("suitcase", 0.15),
        FurnitureRule("box", 0.1),
        FurnitureRule("ball", 0.1, "anywhere"),
    ),
    BATHROOM: (
        FurnitureRule("bathtub", 0.8),
        FurnitureRule("toilet", 1.0),
        FurnitureRule("sink", 1.0),
        FurnitureRule("washing machine", 0.4),
        FurnitureRule("cabinet", 0.35),
        FurnitureRule("trash can", 0.35),
        FurnitureRule("stool", 0.1),
        FurnitureRule("plant", 0.1, "corner"),
    ),
    OFFICE: (
        FurnitureRule("desk", 1.0, most=2, more=0.15),
        FurnitureRule("chair", 1.0, "before", ("desk",)),
        FurnitureRule("bookshelf", 0.85, most=3, more=0.45),
        FurnitureRule("laptop", 0.85, "on", ("desk",)),
        FurnitureRule("cabinet", 0.4),
        FurnitureRule("armchair", 0.2),
        FurnitureRule("lamp", 0.5, "corner"),
        FurnitureRule("trash can", 0.6),
        FurnitureRule("plant", 0.35, "corner"),
        FurnitureRule("rug", 0.2, "floor", ("desk",)),
        FurnitureRule("picture", 0.5, "hung", most=2, more=0.4),
        FurnitureRule("box", 0.3, most=2, more=0.4),
    ),
    HALLWAY: (
        FurnitureRule("cabinet", 0.3),
        FurnitureRule("stool", 0.12),
        FurnitureRule("plant", 0.25, "corner"),
        FurnitureRule("lamp", 0.15, "corner"),
        FurnitureRule("picture", 0.6, "hung", most=3, more=0.5),
        FurnitureRule("backpack", 0.15),
        FurnitureRule("suitcase", 0.12),
        FurnitureRule("box", 0.12),
    ),
}
"""Rules in the order of placing: necessary and large objects come first."""

STRAY_P = 0.2
STRAYS = (
    FurnitureRule("ball", 1.0, "anywhere"), FurnitureRule("box", 1.0), FurnitureRule("backpack",
    1.0), FurnitureRule("suitcase", 1.0),
    FurnitureRule("stool", 1.0), FurnitureRule("chair", 1.0), FurnitureRule("plant", 1.0),
    FurnitureRule("lamp", 1.0, "corner"),
)  # fmt: skip
"""With the probability `STRAY_P`, a room of any kind gets one of these."""
