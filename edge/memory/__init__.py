"""Memory between missions: seen objects and rooms, and places, zones and room names from people."""

from edge.memory.crops import MAX_CROP_BYTES, CropStore
from edge.memory.objects import KnownObject, known_objects, similar_is, where_is
from edge.memory.relations import DescribedTargets, DescribedThing, RelationError, described
from edge.memory.room_kinds import ROOM_KINDS, is_room_name, kind_of_room
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
    without_mapped,
    write_site,
)

__all__ = [
    "MAX_CROP_BYTES", "NO_SURVEY", "RECOGNISED_KINDS", "ROOM_KINDS", "START", "CropStore",
    "DescribedTargets", "DescribedThing", "Item", "KnownObject", "LostRoom", "MappedRoom",
    "Passage", "Place", "RelationError", "RoomMemory", "RoomName", "RoomSurvey", "SeenObjectIndex",
    "SeenObjects", "Site", "SiteError", "SiteFile", "Zone", "described", "is_room_name", "item_of",
    "kind_of_room", "kinds_by_region", "known_objects", "memory_geojson", "merged",
    "objects_by_region", "outlined", "read_site", "similar_is", "site_of", "survey_rooms",
    "where_is", "without_mapped", "write_site",
]  # fmt: skip
