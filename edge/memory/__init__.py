"""Memory between missions: seen objects and rooms, and places, zones and room names from people."""

from edge.memory.crops import MAX_CROP_BYTES, CropStore
from edge.memory.objects import KnownObject, describe_location, describe_similar, known_objects
from edge.memory.relations import (
    DescribedObject,
    DescribedTargets,
    RelationError,
    parse_description,
    without_room,
)
from edge.memory.room_kinds import ROOM_KINDS, is_room_name, kind_of_room
from edge.memory.room_shapes import NO_SURVEY, LostRoom, RoomSurvey, outline_rooms, survey_rooms
from edge.memory.rooms import (
    RECOGNISED_KINDS,
    MappedRoom,
    RoomMemory,
    SeenObjectIndex,
    SeenObjects,
    kinds_by_region,
    objects_by_region,
)
from edge.memory.site import START, Item, Place, RoomName, Site, SiteError, Zone
from edge.memory.site_geojson import (
    SiteFile,
    item_of,
    memory_geojson,
    read_site,
    site_of,
    without_mapped,
    write_site,
)
