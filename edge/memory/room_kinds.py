"""Words for kinds of rooms.

A word that also names an object, such as "toilet" or "bath", is no word for a room.
"""

from __future__ import annotations

from edge import names, number_words

ROOM_KINDS: dict[str, tuple[str, ...]] = {
    "attic": ("loft",),
    "balcony": (),
    "basement": ("cellar",),
    "bathroom": (
        "bath room", "washroom", "wash room", "restroom", "rest room", "shower room",
        "toilet room", "powder room",
    ),
    "bedroom": ("bed room", "sleeping room"),
    "classroom": ("class room",),
    "dining room": ("diningroom", "breakfast room"),
    "garage": ("car port", "carport"),
    "hallway": ("hall", "corridor", "passageway", "entrance hall"),
    "kitchen": ("kitchenette",),
    "laundry room": ("laundry", "utility room", "wash house"),
    "library": (),
    "living room": (
        "livingroom", "lounge", "sitting room", "family room", "parlor", "parlour",
        "drawing room", "front room",
    ),
    "meeting room": ("conference room",),
    "nursery": ("children's room", "kids room"),
    "office": ("study", "home office", "work room", "workroom"),
    "storage room": ("storeroom", "store room", "pantry", "box room"),
    "workshop": ("studio", "art room"),
}  # fmt: skip
"""Kind of room → other words for it. No word appears twice."""

_KIND = {
    names.normalise(word): kind for kind, words in ROOM_KINDS.items() for word in (kind, *words)
}


def kind_of_room(word: str) -> str | None:
    """Return the kind of room that a word names, or None.

    >>> kind_of_room("the lounge"), kind_of_room("Sitting Rooms"), kind_of_room("toilet")
    ('living room', 'living room', None)
    """
    if not names.is_name(word):
        return None
    text = names.normalise(word)
    return _KIND.get(text) or _KIND.get(names.singular(text))


def is_room_name(word: str) -> bool:
    """Return True for a word for a kind of room, and for a room's number, such as "room 3".

    >>> is_room_name("the lounge"), is_room_name("room three"), is_room_name("toilet")
    (True, True, False)
    """
    kind, *number = names.normalise(word).split()
    numbered = kind in ("room", "ward", "bay", "aisle") and number
    return bool(kind_of_room(word) or (numbered and number_words.number(number) is not None))
