"""What is remembered: objects and rooms; places, zones and room names that people gave."""

from edge.memory.objects import KnownObject, known_objects, where_is
from edge.memory.room_kinds import ROOM_KINDS, kind_of_room
from edge.memory.room_shapes import (
    NO_SURVEY,
    LostRoom,
    Passage,
    RoomSurvey,
    outlined,
    survey_rooms,
)
from edge.memory.rooms import (
    MappedRoom,
    RoomMemory,
    SeenObjectIndex,
    SeenObjects,
    objects_by_region,
    room_kinds_at,
)
from edge.memory.site import (
    START,
    Item,
    Place,
    RoomName,
    Site,
    SiteError,
    SiteFile,
    Zone,
    item_of,
    merged,
    read_site,
    site_of,
    write_site,
)

__all__ = [
    "NO_SURVEY", "ROOM_KINDS", "START", "Item", "KnownObject", "LostRoom", "MappedRoom", "Passage",
    "Place", "RoomMemory", "RoomName", "RoomSurvey", "SeenObjectIndex", "SeenObjects", "Site",
    "SiteError", "SiteFile", "Zone", "item_of", "kind_of_room", "known_objects", "merged",
    "objects_by_region", "outlined", "read_site", "room_kinds_at", "site_of", "survey_rooms",
    "where_is", "write_site",
]  # fmt: skip
