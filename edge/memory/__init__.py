"""What is remembered: objects that were seen; places and zones that people gave."""

from edge.memory.objects import KnownObject, known_objects, where_is
from edge.memory.site import (
    START,
    Item,
    Place,
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
    "START", "Item", "KnownObject", "Place", "Site", "SiteError", "SiteFile", "Zone",
    "item_of", "known_objects", "memory_geojson", "merged", "read_site", "site_of",
    "where_is", "write_site",
]  # fmt: skip
