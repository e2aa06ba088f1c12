"""A recorded run over one or several files: the journal page by page, with its observations.

A page is one message of the journal (`edge.recording.journal`). The images, depth and clouds of its
observation are in messages of other channels, just before the page.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edge.bus.wire import compressed, messages
from edge.config import Config
from edge.config.section import plugin_kinds
from edge.errors import ConfigError
from edge.recording import channels, journal
from edge.recording.file import McapReader, RecordedMessage, RecordingError
from edge.recording.journal import FORMAT, VERSION, JournalPage
from edge.recording.rolling import files_of
from edge.text import one_line, read_json
from edge.types import Observation


@dataclass(frozen=True)
class RecordingHeader:
    """Metadata of a file of a recorded run.

    Attributes:
        part: number of the file within the run, from 0.
        config: the configuration as JSON, without secrets.
    """

    path: Path
    session: str
    part: int
    edge: str
    config: dict


class RecordedStep(NamedTuple):
    """One page of the journal with its observation.

    Attributes:
        observation: the page's observation with its recorded arrays; None: there was none.
        picture: True if `rgb` is a recorded image; otherwise `rgb` is black, or None without a
            camera.
        missing: names of arrays of the observation that were not recorded (`depth`, `cloud`).
    """

    page: JournalPage
    observation: Observation | None
    picture: bool
    missing: tuple[str, ...]


def read_header(path: Path) -> RecordingHeader:
    """Read the metadata of a file.

    Raises:
        RecordingError: no file, no MCAP file, no recording of a run, or one of another version.
    """
    reader = McapReader(path)
    next(iter(reader), None)
    metadata = reader.metadata.get(FORMAT)
    if metadata is None:
        raise RecordingError(
            f"{path}: an MCAP file, but not of the sink `mcap`, so there is no journal to replay; "
            "`edge play FILE CONFIG` plays the recording of any robot"
        )
    if metadata.get("version") != str(VERSION):
        raise RecordingError(
            f"{path}: recorded by edge {one_line(metadata.get('edge', '?'), 40)} in version "
            f"{one_line(metadata.get('version', '?'), 20)} of the format; this edge reads version "
            f"{VERSION}"
        )
    try:
        config = dict(read_json(metadata["config"], journal.MAX_VALUES).items())
        edge = one_line(metadata["edge"], 40)
        return RecordingHeader(path, metadata["session"], int(metadata["part"]), edge, config)
    except (KeyError, ValueError, AttributeError):
        raise RecordingError(f"{path}: damaged: the metadata cannot be read") from None


class RecordedRun:
    """The files of one run from `path` on.

    Args:
        path: the first file.
        trust: allow the recorded configuration to name classes and files. Otherwise the author of
            a recording could choose what runs on this computer.

    Attributes:
        head: metadata of the first file.
        files: the files of the run from the first on, without gaps.
        truncation: what is missing at the end, in one line; empty if nothing is.
        gap: why the run ends before its files do; empty if it does not.

    Raises:
        RecordingError: see `read_header`.
    """

    def __init__(self, path: Path, trust: bool = False) -> None:
        self.trust = trust
        self.head = read_header(path)
        self.files = _files_from(self.head)
        self.truncation = self.gap = ""

    def config(self) -> Config:
        """Return the recorded configuration, without secrets.

        Raises:
            RecordingError: this version of edge cannot use it, or see `check`.
        """
        try:
            config = journal.config_of(dict(self.head.config))
        except ConfigError as error:
            first = one_line(str(error).splitlines()[0], 400)
            raise RecordingError(
                f"{self.head.path}: the configuration in it, of edge {self.head.edge}, cannot be "
                f"used: {first}; give your own with --config"
            ) from None
        self.check(config)
        return config

    def check(self, config: Config) -> None:
        """Raise an error for a recorded configuration that names a class, unless it is trusted.

        Raises:
            RecordingError: it names a class; nothing was imported.
        """
        for key, kind in () if self.trust else plugin_kinds(config):
            raise RecordingError(
                f"{self.head.path}: {key}: {one_line(kind, 80)} is no built-in kind; it is "
                "not loaded, because a recording may name any program: give your own "
                "configuration with --config, or --trust if you know who made the recording"
            )

    def messages(self) -> Iterator[RecordedMessage]:
        """Yield the messages of all files in the order in which they were written."""
        for path in self.files:
            reader = McapReader(path)
            yield from reader
            if reader.truncation:
                self.truncation = f"{path}: {reader.truncation}"

    def steps(self) -> Iterator[RecordedStep]:
        """Yield every page of the journal, up to the first gap.

        Raises:
            RecordingError: the journal is damaged.
        """
        array_messages: dict[str, RecordedMessage] = {}
        rig: dict[str, Any] = {}
        n = 0  # number of entries so far; the next entry has this number
        for m in self.messages():
            if m.topic in _ARRAY_TOPICS:
                array_messages[_ARRAY_TOPICS[m.topic]] = m
            if m.topic != channels.JOURNAL.topic:
                continue
            try:
                page = journal.decode_page(m.payload)
                step = _make_step(page, array_messages, rig)
            except Exception as error:  # damaged data can raise anything
                raise RecordingError(
                    f"{self.head.path}: damaged journal: {type(error).__name__}: "
                    f"{one_line(error, 120)}"
                ) from None
            array_messages.clear()
            numbers = [entry.n for entry in page.entries]
            if numbers != list(range(n, n + len(numbers))):
                self.gap = "the messages that follow were dropped while recording"
                return
            n += len(numbers)
            if step.missing:
                missing = " and ".join(step.missing)
                self.gap = f"the next frame's {missing} was dropped while recording"
                return
            yield step


def _files_from(head: RecordingHeader) -> list[Path]:
    """Return this file of a run and those that follow in the same folder, up to a gap."""
    files, part = [head.path], head.part
    parts: dict[int, Path] = {}
    for path in files_of(head.path.resolve().parent):
        try:
            other = read_header(path)
        except RecordingError:
            continue
        if other.session == head.session:
            parts[other.part] = path
    while (part := part + 1) in parts:
        files.append(parts[part])
    return files


_MAX_PIXELS = 1 << 26  # of an image
# Topic → topic of the first camera. A tick has the arrays of one camera.
_ARRAY_TOPICS = {c.topic: c.topic for c in (channels.PICTURE, channels.DEPTH, channels.CLOUD)}
_ARRAY_TOPICS |= {channels.SECOND[c].topic: c.topic for c in (channels.PICTURE, channels.DEPTH)}


def _make_step(
    page: JournalPage, array_messages: dict[str, RecordedMessage], rig: dict[str, Any]
) -> RecordedStep:
    fields = page.observation
    if fields is None:
        return RecordedStep(page, None, False, ())
    depth_m, cloud_m = _decode_depth(array_messages), _decode_cloud(array_messages)
    rgb = _decode_picture(array_messages)
    picture = rgb is not None
    if rgb is None and fields["rgb_hw"] is not None:
        height, width = fields["rgb_hw"]
        _check_pixels(height, width)
        rgb = np.zeros((height, width, 3), np.uint8)
    arrays = {"depth": depth_m, "cloud": cloud_m}
    missing = tuple(name for name, array in arrays.items() if fields[name] and array is None)
    observation = journal.observation_of(fields, rig, rgb, depth_m, cloud_m)
    return RecordedStep(page, observation, picture, missing)


def _check_pixels(height: int, width: int) -> None:
    if not 0 <= height * width <= _MAX_PIXELS:
        raise ValueError(f"an image of {height}x{width} pixels, at most {_MAX_PIXELS} are allowed")


def _decode_depth(array_messages: dict[str, RecordedMessage]) -> np.ndarray | None:
    """Return the recorded depth in metres, (h, w) float32; None if there is none."""
    if (m := array_messages.get(channels.DEPTH.topic)) is None:
        return None
    header = messages.decode_image_header(m.payload)
    # Exact millimetres from the sink: every value is valid, so do not decode as invalid depth.
    exact = header.encoding == "16UC1"
    out = np.empty((header.height, header.width), np.uint16 if exact else np.float32)
    messages.decode_image_into(m.payload, header, out)
    return out * np.float32(0.001) if exact else out


def _decode_cloud(array_messages: dict[str, RecordedMessage]) -> np.ndarray | None:
    if (m := array_messages.get(channels.CLOUD.topic)) is None:
        return None
    out = np.empty((len(m.payload) // 12, 3), np.float32)  # a point has at least 12 bytes
    return out[: messages.decode_point_cloud_into(m.payload, out, keep_invalid=True)].copy()


def _decode_picture(array_messages: dict[str, RecordedMessage]) -> np.ndarray | None:
    """Return the recorded image, (h, w, 3) uint8 RGB; None if there is none."""
    if (m := array_messages.get(channels.PICTURE.topic)) is None:
        return None
    header = compressed.decode_compressed_header(m.payload)
    _check_pixels(header.height, header.width)
    out = np.empty((header.height, header.width, 3), np.uint8)
    compressed.decode_compressed_into(m.payload, header, out)
    return out
