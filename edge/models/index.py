"""Finding wheels: on package indexes (PEP 503, PEP 691), and in folders as pip's find-links."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urljoin, urlsplit
from urllib.request import url2pathname

from edge.host import resources
from edge.host.files import read_regular
from edge.models.download import read_page, shown
from edge.models.pace import LIMITS, Limits
from edge.models.part import FetchError

PYPI = "https://pypi.org/simple"
_JSON = "application/vnd.pypi.simple.v1+json"
_ACCEPT = f"{_JSON}, application/vnd.pypi.simple.v1+html;q=0.2, text/html;q=0.1"


class Wheel(NamedTuple):
    """A wheel on an index: its address (http, https or file), and its hash and size if told."""

    url: str
    sha256: str | None
    size: int | None

    @property
    def name(self) -> str:
        return unquote(urlsplit(self.url).path).rpartition("/")[2]


class Places(NamedTuple):
    """Where pip would look: addresses of indexes, in order, and folders of wheels."""

    indexes: tuple[str, ...]
    folders: tuple[str, ...]


def configured_places() -> Places:
    """As the environment and pip's configuration say; PyPI where they say nothing."""
    settings = _pip_settings()
    main = os.environ.get("PIP_INDEX_URL") or settings.get("index-url") or PYPI
    extra = os.environ.get("PIP_EXTRA_INDEX_URL") or settings.get("extra-index-url", "")
    folders = os.environ.get("PIP_FIND_LINKS") or settings.get("find-links", "")
    none = os.environ.get("PIP_NO_INDEX") or settings.get("no-index", "")
    if none.lower() not in ("", "0", "false", "no", "off"):
        return Places((), tuple(folders.split()))
    return Places((*main.split()[:1], *extra.split()), tuple(folders.split()))


def _pip_settings() -> dict[str, str]:
    """`pip config list`, keys without their section; empty where there is no pip."""
    command = [sys.executable, "-m", "pip", "config", "list"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return {}
    settings = {}
    for line in done.stdout.splitlines():
        if found := re.fullmatch(r"(?:global|install|download)\.([a-z-]+)=('.*'|\".*\")", line):
            settings[found[1]] = str(ast.literal_eval(found[2]))
    return settings


def find_wheels(package: str, index: str, limits: Limits = LIMITS) -> list[Wheel]:
    """The wheels of `name==version` on one index, those for any platform first.

    Raises:
        FetchError: the index cannot be read, or has none.
    """
    name, _, version = package.partition("==")
    address = f"{index.rstrip('/')}/{_normal(name)}/"
    base, files = _read_index(address, limits)
    wheels = []
    for href, sha256, size in files:
        try:
            split = urlsplit(urljoin(base, href))
        except ValueError:  # no address; the page has others
            continue
        # A page from the network has no say over files of this machine.
        local = urlsplit(base).scheme == "file"
        allowed = ("http", "https", "file") if local else ("http", "https")
        if split.scheme in allowed and is_wheel_of(unquote(split.path), name, version):
            wheels.append(Wheel(split._replace(fragment="").geturl(), sha256, size))
    if not wheels:
        raise FetchError(f"{shown(address)}: no wheel of {package}")
    return sorted(wheels, key=lambda wheel: not wheel.url.endswith("-any.whl"))


def is_wheel_of(path: str, name: str, version: str) -> bool:
    """Whether a file's name is that of a wheel of this package and version."""
    file = path.rpartition("/")[2]
    parts = file.removesuffix(".whl").split("-")
    return (
        re.fullmatch(r"[A-Za-z0-9_.!+-]+\.whl", file) is not None
        and len(parts) in (5, 6)
        and _normal(parts[0]) == _normal(name)
        and parts[1].lower() == version.lower()
    )


def local_path(url_or_path: str) -> Path:
    """The file of a `file:` address, or of a path."""
    if url_or_path.startswith("file:"):
        return Path(url2pathname(urlsplit(url_or_path).path))
    return resources.expand(url_or_path)


def _normal(name: str) -> str:
    """PEP 503's normal form of a project's name."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _read_index(address: str, limits: Limits):  # type: ignore[no-untyped-def]
    """(base address, its files as (href, sha256, size))."""
    if "://" not in address or address.startswith("file:"):
        page = local_path(address) / "index.html"
        try:
            return page.resolve().as_uri(), list(_from_html(read_regular(page)))
        except OSError as error:
            raise FetchError(f"{page}: {error.strerror}") from None
        except ValueError:
            raise FetchError(f"{page}: is no page of a package index") from None
    base, kind, content = read_page(address, _ACCEPT, limits)
    try:
        return base, list(_from_json(content) if kind == _JSON else _from_html(content))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise FetchError(f"{shown(address)}: is no page of a package index") from None


def _from_json(content: bytes) -> Iterator[tuple[str, str | None, int | None]]:
    for file in json.loads(content)["files"]:
        sha256, size = file.get("hashes", {}).get("sha256"), file.get("size")
        if sha256 is not None and not re.fullmatch("[0-9a-f]{64}", sha256):
            raise ValueError(f"no sha256: {sha256!r}")
        yield str(file["url"]), sha256, size if isinstance(size, int) else None


def _from_html(content: bytes) -> Iterator[tuple[str, str | None, int | None]]:
    parser = _Links()
    try:
        parser.feed(content.decode("utf-8", "replace"))
    except AssertionError as error:  # what HTMLParser raises for `<![foo[x]]>`
        raise ValueError(str(error)) from None
    for href in parser.found:
        told = re.search(r"#(?:.*&)?sha256=([0-9a-f]{64})", href)
        yield href, told[1] if told else None, None


class _Links(HTMLParser):
    """The targets of all links."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [value for key, value in attrs if (tag, key) == ("a", "href") and value]
