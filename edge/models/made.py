"""Models that were exported on another machine: the ONNX file and what the export said of it.

A robot needs no torch this way: `edge models export` on a workstation, its cache's `models`
folder on a stick, `edge models pull NAME --from FOLDER` here.
"""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path
from urllib.parse import urljoin

from edge.host import resources
from edge.host.files import read_regular
from edge.models import index
from edge.models.download import download, read_page
from edge.models.local import copy_from
from edge.models.pace import LIMITS, Limits
from edge.models.part import FetchError, Part
from edge.perception.card_types import FileCard


def take_made(card: FileCard, place: str, offline: bool, limits: Limits = LIMITS) -> Path | None:
    """Bring a model that was made elsewhere into the cache; None where the place has none.

    Args:
        place: a folder, or the address of one (which ends in a slash).

    Raises:
        FetchError: it has one that is not what the export said.
    """
    remote = place.startswith(("http://", "https://"))
    if remote and (offline or not place.endswith("/")):
        return None
    said = _read(place, f"{card.file}.json", remote, limits)
    sha256, size = said.get("sha256"), said.get("bytes")
    if not isinstance(sha256, str) or not re.fullmatch("[0-9a-f]{64}", sha256):
        return None
    target = resources.models_dir() / card.file
    # Held against what another export said, a sound model would seem damaged.
    sidecar = target.with_name(f"{target.name}.json"), (json.dumps(said, indent=2) + "\n").encode()
    with Part(target, sha256, size if isinstance(size, int) else None, sidecar) as part:
        if remote:
            download(urljoin(place, card.file), part, limits)
        else:
            copy_from(index.local_path(place) / card.file, part, ())
    return target


def _read(place: str, name: str, remote: bool, limits: Limits) -> dict:
    """What an export said, empty where it said nothing."""
    with contextlib.suppress(FetchError, OSError, ValueError, RecursionError):
        if remote:
            content = read_page(urljoin(place, name), "application/json", limits)[2]
        else:
            content = read_regular(index.local_path(place) / name)
        data = json.loads(content)
        return data if isinstance(data, dict) else {}
    return {}
