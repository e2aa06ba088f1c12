"""Memory between missions: seen objects, and the places and zones that people set."""

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
    merged,
    read_site,
    site_of,
    write_site,
)

__all__ = [
    "START", "Item", "KnownObject", "Place", "Site", "SiteError", "SiteFile", "Zone",
    "item_of", "known_objects", "merged", "read_site", "site_of", "where_is", "write_site",
]  # fmt: skip
