"""What people tell the robot of a site: named places, zones, room names."""

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
    "START", "Item", "Place", "RoomName", "Site", "SiteError", "SiteFile", "Zone", "item_of",
    "merged", "read_site", "site_of", "write_site",
]  # fmt: skip
