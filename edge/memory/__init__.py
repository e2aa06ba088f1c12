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
    RECOGNISED_KINDS,
    MappedRoom,
    RoomMemory,
    SeenObjectIndex,
    SeenObjects,
    kinds_by_region,
    objects_by_region,
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
    memory_geojson,
    merged,
    read_site,
    site_of,
    write_site,
)

__all__ = [
    "NO_SURVEY", "RECOGNISED_KINDS", "ROOM_KINDS", "START", "Item", "KnownObject", "LostRoom",
    "MappedRoom", "Passage", "Place", "RoomMemory", "RoomName", "RoomSurvey", "SeenObjectIndex",
    "SeenObjects", "Site", "SiteError", "SiteFile", "Zone", "item_of", "kind_of_room",
    "kinds_by_region", "known_objects", "memory_geojson", "merged", "objects_by_region", "outlined",
    "read_site", "site_of", "survey_rooms", "where_is", "write_site",
]  # fmt: skip
