"""Camera over ZeroMQ: JSON header and raw pixels. Other topics come over Zenoh.

Each message has two parts. The header, at most 4 KB of JSON:

    {"topic": "camera/rgb", "stamp": <ns>, "height": 480, "width": 640, "encoding": "bgr8",
     "intrinsics": [fx, fy, cx, cy]}

and the pixels, row by row without padding. `topic` is `camera/rgb` or `camera/depth`. `encoding` is
one of sensor_msgs/Image (rgb8, bgr8, rgba8, bgra8, mono8, 16UC1, 32FC1; little-endian). Depth is in
mm (16UC1) or m (32FC1), unless `source.depth_unit_m` gives another unit. `intrinsics`, in pixels,
are needed once, and again when they change.
"""

from __future__ import annotations

import logging
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
import zenoh

from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import images, messages
from edge.config import Config, ConfigError
from edge.geometry import CameraModel
from edge.host.interruptible import start_detached_thread
from edge.recording.channels import Channel, topic_channel
from edge.sources.messages import CameraInfo, DepthImage, Image, SensorFrame, WrongSizeError
from edge.sources.streams import KEPT
from edge.sources.zenoh import ZenohSource
from edge.text import bounded_repr, one_line, read_json_object

if TYPE_CHECKING:
    import zmq

log = logging.getLogger("edge.sources.zmq")

MAX_HEADER = 4096
"""Longest header in bytes."""
_CHECK_S = 1.0  # period of checks of the connection
_FRAME_ID = "camera"  # of recorded messages
_MAX_PX = 1e7  # largest intrinsics
# Encoding → bytes of a pixel.
_BYTES_PX = {
    "rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "16UC1": 2, "32FC1": 4,
}  # fmt: skip
_FRAMES: dict[str, type[SensorFrame]] = {"camera/rgb": Image, "camera/depth": DepthImage}
_FIELDS = ("topic", "stamp", "height", "width", "encoding", "intrinsics")


@dataclass(frozen=True, slots=True)
class ZmqHeader:
    """The parsed header of a message.

    Attributes:
        topic: `camera/rgb` or `camera/depth`.
        image: size, encoding and stamp of the image.
        camera: intrinsics; None if the header has none.
    """

    topic: str
    image: images.ImageHeader
    camera: CameraModel | None


def parse_header(data: bytes, n_bytes: int) -> ZmqHeader:
    """Parse the header of a message.

    Args:
        data: JSON, see the module's docstring.
        n_bytes: size of the pixels, which must match the header.

    Raises:
        ValueError: with one line that names the fault.
    """
    fields = read_json_object(data, MAX_HEADER)
    if unknown := fields.keys() - set(_FIELDS):
        names = ", ".join(_FIELDS)
        raise ValueError(f"unknown field {one_line(min(unknown), 40)!r} (choices: {names})")
    topic, encoding = fields.get("topic"), fields.get("encoding")
    if not isinstance(topic, str) or topic not in _FRAMES:
        raise ValueError(
            f"topic: unknown {bounded_repr(topic, 40)} (choices: {', '.join(_FRAMES)})"
        )
    if not isinstance(encoding, str) or encoding not in _BYTES_PX:
        raise ValueError(
            f"encoding: unknown {bounded_repr(encoding, 40)} (choices: {', '.join(_BYTES_PX)})"
        )
    stamp_ns, height, width = (
        _non_negative_int(fields, name) for name in ("stamp", "height", "width")
    )
    step = width * _BYTES_PX[encoding]
    if height * step != n_bytes:
        raise ValueError(f"{width}x{height} {encoding} is {height * step} bytes, got {n_bytes}")
    image = images.ImageHeader(
        stamp_ns, "", height, width, encoding, step, data_offset=0, big_endian=False
    )
    return ZmqHeader(topic, image, _parse_intrinsics(fields.get("intrinsics"), width, height))


def _non_negative_int(fields: dict[str, Any], name: str) -> int:
    value = fields.get(name)
    if type(value) is not int or not 0 <= value < 1 << 63:
        raise ValueError(f"{name}: expected an integer, got {bounded_repr(value, 40)}")
    return value


def _parse_intrinsics(intrinsics: object, width: int, height: int) -> CameraModel | None:
    """Parse intrinsics; raise ValueError if they are neither None nor a camera."""
    if intrinsics is None:
        return None
    is_four = isinstance(intrinsics, list) and len(intrinsics) == 4
    if not is_four or not all(type(v) in (int, float) and abs(v) <= _MAX_PX for v in intrinsics):
        raise ValueError(
            f"intrinsics: expected [fx, fy, cx, cy] in px, got {bounded_repr(intrinsics, 40)}"
        )
    return CameraModel(width, height, *map(float, intrinsics))


def _decode_checked(
    unit_m: float | None, buffer: memoryview, header: images.ImageHeader, out: np.ndarray
) -> int:
    """Decode pixels into `out`; raise WrongSizeError if the image has another size."""
    if (header.height, header.width) != out.shape[:2]:
        height, width = out.shape[:2]
        says = f"the intrinsics are of {width}x{height}"
        raise WrongSizeError(f"image is {header.width}x{header.height}, {says}")
    images.decode_image_into(buffer, header, out, unit_m)
    return header.height


class ZmqSource(ZenohSource):
    """Source of a camera that publishes at `address`, and of other sensors under `zenoh.prefix`.

    This end connects, so only the process that listens at that address can send. A message over
    `source.max_message_mb` is refused: ZeroMQ then closes the connection, and it is opened again.

    Raises:
        ConfigError: pyzmq is not installed, the address is invalid, or the configuration needs a
            cloud but has no `sensors.lidar`.
    """

    NOT_FROM_ZENOH = (topics.RGB, topics.DEPTH, topics.CAMERA_INFO)

    def __init__(
        self,
        config: Config,
        session: zenoh.Session,
        address: str,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._clock = clock
        self._address = address
        self._depth_unit_m = config.source.depth_unit_m
        super().__init__(config, session)
        self._camera = _CameraSocket(config, address)
        start_detached_thread("camera-name", _warn_unresolved, address)

    @staticmethod
    def check_options(config: Config, address: str, **options: Any) -> None:
        """Raise an error for invalid options; see `PolledSource.check_options`."""
        ZenohSource.check_options(config)
        _check_address(config, address)

    def close(self) -> None:
        super().close()
        self._camera.close()

    def _where(self, topic: Topic) -> str:
        return one_line(self._address) if topic in self.NOT_FROM_ZENOH else super()._where(topic)

    def _drain(self) -> int:
        return super()._drain() + self._drain_camera()

    def _drain_camera(self) -> int:
        """Read at most `KEPT` messages, so that a flood cannot block the loop; return how many."""
        n = 0
        for parts in self._camera.take(copy=False):
            self._offer(parts)
            n += 1
        return n

    def _offer(self, parts: list[zmq.Frame]) -> None:
        """Pass a camera message to the synchronizer, or count it as malformed."""
        topic = one_line(self._address)
        try:
            if len(parts) != 2:
                raise ValueError(f"expected two message parts, header and pixels, got {len(parts)}")
            if len(parts[0]) > MAX_HEADER:
                raise ValueError(
                    f"header has {len(parts[0])} bytes, at most {MAX_HEADER} are allowed"
                )
            header = parse_header(parts[0].bytes, len(parts[1]))
        except ValueError as error:
            self._synchronizer.received(topic)
            self._synchronizer.count(topic, "malformed", str(error))
            return
        self._synchronizer.received(header.topic)
        if header.camera is not None:
            self._synchronizer.inputs.on_message(CameraInfo.topic)
            self._synchronizer.offer(CameraInfo(header.camera))
        into = partial(_decode_checked, self._depth_unit_m, parts[1].buffer, header.image)
        frame = _FRAMES[header.topic](
            header.image.stamp_ns, self._clock(), into, size=len(parts[1])
        )
        self._synchronizer.offer(frame)


class _CameraSocket:
    """The connection to a camera, which is opened again when it is lost.

    Raises:
        ConfigError: pyzmq is not installed, or the address is invalid.
    """

    def __init__(self, config: Config, address: str) -> None:
        self._address, self._max_bytes = address, int(config.source.max_message_mb * 1e6)
        _check_address(config, address)
        self._zmq, self._context, self._socket = _open_socket(config, self._max_bytes)
        # Connect at the first poll: earlier messages would wait in ZeroMQ's queues.
        self._connected = False
        self._disconnects = self._socket.get_monitor_socket(self._zmq.EVENT_DISCONNECTED)
        self._disconnect_warned = False
        self._check_s = 0.0

    def take(self, copy: bool) -> Iterator[list[Any]]:
        """Yield the parts of at most `KEPT` messages since the last poll.

        Args:
            copy: True for parts as bytes, False for frames.
        """
        if not self._connected:
            self._socket.connect(self._address)
            self._connected = True
        for _ in range(KEPT):
            try:
                parts = self._socket.recv_multipart(self._zmq.NOBLOCK, copy=copy)
            except self._zmq.Again:
                self._reconnect_if_lost()
                return
            yield parts

    def close(self) -> None:
        self._socket.disable_monitor()
        self._context.destroy(linger=0)

    def _reconnect_if_lost(self) -> None:
        """Check once a second for a lost connection, and connect again.

        ZeroMQ does not connect again to a camera that sent too large a message.
        """
        now_s = time.monotonic()
        if now_s < self._check_s:
            return
        self._check_s = now_s + _CHECK_S
        if not self._disconnects.poll(0):
            return
        while self._disconnects.poll(0):
            self._disconnects.recv_multipart()
        with suppress(self._zmq.ZMQError):  # it is disconnected already
            self._socket.disconnect(self._address)
        self._socket.connect(self._address)
        if not self._disconnect_warned:
            self._disconnect_warned = True
            log.warning(
                "%s: the camera disconnected, or sent more than %g MB "
                "(source.max_message_mb); connecting again (not logged again)",
                one_line(self._address), self._max_bytes / 1e6,
            )  # fmt: skip


class ZmqTap:
    """The images of a camera over ZeroMQ as messages of the bus, for recordings.

    Raises:
        ConfigError: see `ZmqSource`.
    """

    def __init__(self, config: Config) -> None:
        self._camera = _CameraSocket(config, config.source.options.get("address", ""))
        self._warned = False

    def take(self) -> Iterator[tuple[Channel, bytes]]:
        """Yield the messages since the last poll."""
        for parts in self._camera.take(copy=True):
            try:
                yield from _bus_messages(*parts)
            except (ValueError, TypeError) as error:
                if not self._warned:
                    self._warned = True
                    log.warning(
                        "a camera message was not recorded: %s; further ones are not logged",
                        one_line(error),
                    )

    def close(self) -> None:
        self._camera.close()


def _bus_messages(head: bytes, pixels: bytes) -> Iterator[tuple[Channel, bytes]]:
    """Convert a message for the bus; raise ValueError if it is malformed."""
    header = parse_header(head, len(pixels))
    image, topic = header.image, _FRAMES[header.topic].topic
    if header.camera is not None:
        info = messages.encode_camera_info(image.stamp_ns, _FRAME_ID, header.camera)
        yield topic_channel(topics.CAMERA_INFO), info
    shape, is_depth = (image.height, image.width), topic == topics.DEPTH.key
    # Depth in the unit of the camera: `source.depth_unit_m` is applied when it is replayed.
    dtype = (np.uint16 if image.encoding == "16UC1" else np.float32) if is_depth else np.uint8
    out = np.empty(shape if is_depth else (*shape, 3), dtype)
    images.decode_image_into(pixels, image, out)
    yield (
        topic_channel(topics.DEPTH if is_depth else topics.RGB),
        messages.encode_image(image.stamp_ns, _FRAME_ID, out),
    )


def _open_socket(config: Config, max_bytes: int) -> tuple[Any, zmq.Context, zmq.Socket]:
    """Return the module zmq, a context, and a socket that is not connected yet."""
    try:
        import zmq
    except ImportError:
        where = config.locate("source.kind")
        raise ConfigError(f"{where}: zmq needs pyzmq: pip install 'edge-vln[zmq]'") from None
    context = zmq.Context()
    camera = context.socket(zmq.SUB)
    camera.setsockopt(zmq.MAXMSGSIZE, max_bytes)
    camera.setsockopt(zmq.RCVHWM, KEPT)
    camera.setsockopt(zmq.LINGER, 0)
    camera.subscribe(b"")
    return zmq, context, camera


def _warn_unresolved(address: str) -> None:
    """Log if the camera's host name cannot be resolved: ZeroMQ retries without a message."""
    host = urlsplit(address).hostname
    if not address.startswith("tcp://") or host is None:
        return
    try:
        socket.getaddrinfo(host, None)
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or error
        log.warning("source.options.address: no address is known for %r (%s); trying again",
                    one_line(host), one_line(why))  # fmt: skip


def _check_address(config: Config, address: str) -> None:
    """Raise ConfigError for an invalid address."""
    _, context, camera = _open_socket(config, 0)
    try:
        camera.connect(address)
    except Exception as error:  # ZMQError, or others for an address of the wrong type
        cause = f"{one_line(address)}: {one_line(error)}"
        where = config.locate("source.options.address")
        raise ConfigError(
            f"{where}: {cause}; give an address such as tcp://127.0.0.1:5555"
        ) from None
    finally:
        context.destroy(linger=0)
