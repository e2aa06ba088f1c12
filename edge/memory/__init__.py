"""What is remembered: objects that were seen; places and zones that people gave."""

from edge.memory.crops import MAX_CROP_BYTES, CropStore
from edge.memory.objects import KnownObject, known_objects, similar_is, where_is
from edge.memory.relations import DescribedTargets, DescribedThing, RelationError, described
from edge.memory.site import (
    START,
    Item,
    Place,
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
    "MAX_CROP_BYTES",
    "START",
    "CropStore",
    "DescribedTargets",
    "DescribedThing",
    "Item",
    "KnownObject",
    "Place",
    "RelationError",
    "Site",
    "SiteError",
    "SiteFile",
    "Zone",
    "described",
    "item_of",
    "known_objects",
    "merged",
    "read_site",
    "similar_is",
    "site_of",
    "where_is",
    "write_site",
]  # fmt: skip
