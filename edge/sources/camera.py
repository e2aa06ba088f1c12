"""A camera that OpenCV opens: an RTSP or HTTP stream, a V4L2 device, or a video file.

Its images are the colour images; depth, LiDAR and odometry come over Zenoh. A thread of its own
reads the camera, keeps the newest image, and opens the camera again when it fails or stalls. An
image has the time of its arrival, less `latency_s`.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import zenoh

from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import messages
from edge.config import Config, ConfigError
from edge.geometry import CameraModel, Lens
from edge.host.backoff import pause_after
from edge.recording.channels import Channel, topic_channel
from edge.sources.messages import CameraInfo, Image, WrongSizeError
from edge.sources.zenoh import ZenohSource
from edge.text import bounded_repr, one_line, redact

log = logging.getLogger("edge.sources.camera")

STALL_S = 2.0
"""A camera that sends no image for this time stalls. A stream is opened again then; a device
`/dev/video*` only after OpenCV's own limit, 10 s."""
PAUSE_S, MAX_PAUSE_S = 0.5, 5.0  # before the camera is opened again; doubles with each failure
_CLOSE_S = 3.0  # longest time to wait for the thread at the end
_FRAME_ID = "camera"  # of recorded messages
_LENS_MODEL, _MOST_COEFFICIENTS = "plumb_bob", 5


class CameraReader:
    """Reads a camera on a thread of its own.

    A read that never returns keeps the thread; the camera is then reported as stalled, and the
    thread ends with the process.

    Attributes:
        n_images: number of images so far.
    """

    def __init__(self, address: str) -> None:
        self.n_images = 0
        self._address, self._shown = address, one_line(redact(address))
        self._newest: tuple[int, np.ndarray] | None = None
        self._lock = threading.Lock()  # for the newest image
        self._came_s = time.monotonic()  # when the newest image came, or the reader was made
        self._fault = ""  # that was logged; "": images come
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def take(self) -> tuple[int, np.ndarray] | None:
        """Return arrival [ns] and pixels (BGR, uint8) of the newest image, once; or None."""
        with self._lock:
            newest, self._newest = self._newest, None
        if newest is None and time.monotonic() - self._came_s > STALL_S:
            self._report(f"stalls: no image for over {STALL_S:g} s")
        return newest

    def close(self) -> None:
        """Stop reading."""
        self._closing.set()
        self._thread.join(_CLOSE_S)

    def _run(self) -> None:
        """Open the camera again and again until `close`."""
        logs = cv2.utils.logging
        logs.setLogLevel(logs.LOG_LEVEL_ERROR)  # each failure to open would be a warning
        failures = 0
        while not self._closing.is_set():
            before = self.n_images
            try:
                fault = self._read_until_fault()
            except Exception as error:  # cv2.error, or MemoryError; nothing may end this thread
                fault = f"cannot be read: {one_line(error)}"
            if self._closing.is_set():
                return
            self._report(fault)
            failures = 1 if self.n_images > before else failures + 1
            self._closing.wait(pause_after(failures, PAUSE_S, MAX_PAUSE_S))

    def _read_until_fault(self) -> str:
        """Open the camera and read it; return why that ended, "" if a file was read to its end."""
        before = self.n_images
        is_device = self._address.startswith("/dev/")
        if (is_device or "://" not in self._address) and not os.path.exists(self._address):
            return "cannot be opened: no such file or device"
        limit_ms = int(STALL_S * 1e3)
        limits = [] if is_device else [
            cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, limit_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, limit_ms,
        ]  # fmt: skip
        # FFmpeg would write lines of its own at each attempt; it reads this at its first use.
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        backend = cv2.CAP_V4L2 if is_device else cv2.CAP_FFMPEG
        capture = cv2.VideoCapture(self._address, backend, limits)
        try:
            if not capture.isOpened():
                return "cannot be opened: check the address, the camera and the rights"
            hz = capture.get(cv2.CAP_PROP_FPS) if os.path.isfile(self._address) else 0.0
            due_s = time.monotonic()
            while not self._closing.is_set():
                ok, image = capture.read()
                if not ok and hz and self.n_images > before:
                    return ""  # the end of the file
                if not ok:
                    return "sends no more images"
                self._keep(image)
                if hz > 0:  # a file, at its own rate
                    due_s += 1.0 / hz
                    self._closing.wait(max(0.0, due_s - time.monotonic()))
            return ""
        finally:
            capture.release()

    def _keep(self, image: np.ndarray) -> None:
        newest = time.time_ns(), image
        with self._lock:
            self._newest = newest
        self._came_s = time.monotonic()
        self.n_images += 1
        if self._fault:
            log.info("camera %s: sends images again", self._shown)
            self._fault = ""

    def _report(self, fault: str) -> None:
        """Log the first fault of a series."""
        if fault and not self._fault:
            self._fault = fault
            log.warning("camera %s: %s; opening it again and again", self._shown, fault)


class CameraSource(ZenohSource):
    """Source of a camera at `address`, and of other sensors under `zenoh.prefix`.

    Args:
        address: `rtsp://…`, `http://…`, `/dev/video0`, or a video file, which is played at its rate
            again and again.
        intrinsics: fx, fy, cx, cy of the images, in px.
        distortion: k1, k2, p1, p2, k3 of the lens; empty: the images are rectified.
        latency_s: time from the capture of an image to its arrival, in s.

    Raises:
        ConfigError: an option is invalid.
    """

    NOT_FROM_ZENOH = (topics.RGB, topics.CAMERA_INFO)

    def __init__(
        self,
        config: Config,
        session: zenoh.Session,
        address: str,
        intrinsics: list[float],
        distortion: list[float] | tuple[()] = (),
        latency_s: float = 0.0,
    ) -> None:
        self.check_options(config, address, intrinsics, distortion, latency_s)
        self._address = address
        self._intrinsics, self._distortion = intrinsics, tuple(map(float, distortion))
        self._latency_ns = round(latency_s * 1e9)
        self._hw = (0, 0)  # size of the images that the synchronizer knows
        super().__init__(config, session)
        self._reader = CameraReader(address)

    @staticmethod
    def check_options(
        config: Config, address: Any, intrinsics: Any, distortion: Any = (), latency_s: Any = 0.0
    ) -> None:
        """Raise ConfigError for invalid options; the camera is not opened."""
        ZenohSource.check_options(config)
        where = config.locate("source.options")
        if not isinstance(address, str) or not address or "\0" in address:
            raise ConfigError(
                f"{where}.address: {bounded_repr(address, 40)}; give a URL, a device such as "
                "/dev/video0, or a video file"
            )
        focal_px = intrinsics[:2] if _are_numbers(intrinsics, 4, 4) else (0.0,)
        if min(focal_px) <= 0:
            raise ConfigError(
                f"{where}.intrinsics: {bounded_repr(intrinsics, 40)}; give [fx, fy, cx, cy] in px"
            )
        if not _are_numbers(distortion, 0, _MOST_COEFFICIENTS) or len(distortion) in (1, 2, 3):
            raise ConfigError(
                f"{where}.distortion: {bounded_repr(distortion, 40)}; give [k1, k2, p1, p2, k3], "
                "or leave it out"
            )
        if not _are_numbers([latency_s], 1, 1) or not 0 <= latency_s <= 10:
            raise ConfigError(
                f"{where}.latency_s: {bounded_repr(latency_s, 40)}; give seconds, from 0 to 10"
            )

    def close(self) -> None:
        self._reader.close()
        super().close()

    def _where(self, topic: Topic) -> str:
        is_ours = topic in self.NOT_FROM_ZENOH
        return one_line(redact(self._address)) if is_ours else super()._where(topic)

    def _drain(self) -> int:
        n = super()._drain()
        taken = self._reader.take()
        if taken is None:
            return n
        arrived_ns, bgr = taken
        self._synchronizer.received(Image.topic)
        if bgr.nbytes > self._max_bytes:
            self._synchronizer.count(Image.topic, "oversized", f"{bgr.nbytes} bytes")
            return n + 1
        if bgr.shape[:2] != self._hw:
            self._hw = bgr.shape[:2]
            self._synchronizer.inputs.on_message(CameraInfo.topic)
            self._synchronizer.offer(self._camera_info())
        stamp_ns = arrived_ns - self._latency_ns

        def into(out: np.ndarray) -> int:
            if bgr.shape != out.shape:
                raise WrongSizeError(f"image is {bgr.shape[1]}x{bgr.shape[0]}")
            cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB, dst=out)
            return len(out)

        self._synchronizer.offer(Image(stamp_ns, time.monotonic_ns(), into, size=bgr.nbytes))
        return n + 1

    def _camera_info(self) -> CameraInfo:
        height, width = self._hw
        camera = CameraModel(width, height, *map(float, self._intrinsics))
        if not any(self._distortion):
            return CameraInfo(camera)
        return CameraInfo(camera, Lens(_LENS_MODEL, self._distortion, camera))


class CameraTap:
    """The images of a camera as messages of the bus, for recordings.

    Raises:
        ConfigError: see `CameraSource`.
    """

    def __init__(self, config: Config) -> None:
        options = config.source.options
        CameraSource.check_options(config, **options)
        self._intrinsics = tuple(map(float, options["intrinsics"]))
        self._latency_ns = round(options.get("latency_s", 0.0) * 1e9)
        if any(options.get("distortion", ())):
            log.warning("source.options.distortion: is not recorded; the images are, as they come")
        self._reader = CameraReader(options["address"])

    def take(self) -> Iterator[tuple[Channel, bytes]]:
        """Yield the messages since the last poll."""
        if (taken := self._reader.take()) is None:
            return
        arrived_ns, bgr = taken
        stamp_ns = arrived_ns - self._latency_ns
        camera = CameraModel(bgr.shape[1], bgr.shape[0], *self._intrinsics)
        yield (
            topic_channel(topics.CAMERA_INFO),
            messages.encode_camera_info(stamp_ns, _FRAME_ID, camera),
        )
        rgb = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)
        yield topic_channel(topics.RGB), messages.encode_image(stamp_ns, _FRAME_ID, rgb)

    def close(self) -> None:
        self._reader.close()


def _are_numbers(values: Any, least: int, most: int) -> bool:
    """Return True for a list of finite numbers of such a length."""
    if not isinstance(values, (list, tuple)) or not least <= len(values) <= most:
        return False
    return all(type(value) in (int, float) and abs(value) < 1e7 for value in values)
