"""Benchmark: cost of a frame from the wire into its slot."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from edge.bus import topics
from edge.bus.wire import messages
from edge.config import parse
from edge.geometry import SE2, CameraModel, Grid, Lens
from edge.sources.decoder import CdrDecoder
from edge.sources.messages import DepthImage, Image
from edge.sources.rectify import Rectifier
from edge.sources.synchronizer import TimeSynchronizer

CAMERA = CameraModel.from_hfov(320, 256, 1.3)
PERIOD_NS = 33_333_333


def images() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, (256, 320, 3), dtype=np.uint8)
    return rgb, rng.integers(300, 8000, (256, 320), dtype=np.uint16)


def test_decode_rgb_and_depth(benchmark, against):
    """Compare with a copy of the colours, and OpenCV's conversion of the depth."""
    rgb, depth = images()
    payloads = [messages.encode_image(1, "camera", array) for array in (rgb, depth)]
    out = np.zeros_like(rgb), np.zeros(depth.shape, np.float32)

    def decode():
        for payload, array in zip(payloads, out, strict=True):
            messages.decode_image_into(payload, messages.decode_image_header(payload), array)

    decode()  # the kernel is loaded
    benchmark.extra_info["budget"] = "decode_images_320x256"
    against(lambda: (np.copyto(out[0], rgb), cv2.multiply(depth, 0.001, out[1], dtype=cv2.CV_32F)))
    benchmark(decode)
    assert (out[0] == rgb).all()


def test_rectify_rgb_and_depth(benchmark):
    """Measure decoding and rectification; the budget is a ratio to decoding alone."""
    rgb, depth = images()
    lens = Lens("rational_polynomial", (0.46, -2.65, 7e-4, -3e-4, 1.54, 0.34, -2.47, 1.47), CAMERA)
    rectifier = Rectifier(lens, CAMERA)
    out = np.zeros_like(rgb), np.zeros(depth.shape, np.float32)
    payloads = [messages.encode_image(1, "camera", array) for array in (rgb, depth)]

    def frame(kind, payload: bytes):
        def into(array: np.ndarray) -> int:
            messages.decode_image_into(payload, messages.decode_image_header(payload), array)
            return len(array)

        return kind(1, 1, into)

    frames = [frame(kind, data) for kind, data in zip((Image, DepthImage), payloads, strict=True)]
    benchmark.extra_info["budget"] = "rectify_images_320x256"
    benchmark(lambda: [rectifier.into(f, array) for f, array in zip(frames, out, strict=True)])
    assert out[1].any()


def test_ingest_a_frame(benchmark):
    """Measure the way from camera, depth and two odometry messages to one observation."""
    rgb, depth = images()
    synchronizer = TimeSynchronizer(parse({"perception": {"detector": {"kind": "onnx"}}}))
    decoder = CdrDecoder(synchronizer)
    decoder.offer(topics.CAMERA_INFO, messages.encode_camera_info(1, "camera", CAMERA))

    def next_messages():
        k = next_messages.k = next_messages.k + 1
        stamps = [(2 * k + i) * PERIOD_NS // 2 for i in (0, 1)]
        pose = SE2(0.01 * k, 0.0, 0.0).matrix()
        frame = [(topics.ODOMETRY, messages.encode_odometry(s, pose, 0.3, 0.0)) for s in stamps]
        frame.append((topics.RGB, messages.encode_image(stamps[0] + 5, "camera", rgb)))
        frame.append((topics.DEPTH, messages.encode_image(stamps[0] + 5, "camera", depth)))
        return (frame,), {}

    next_messages.k = 0

    def ingest(frame):
        for topic, payload in frame:
            decoder.offer(topic, payload)
        synchronizer.poll().release()

    benchmark.extra_info["budget"] = "ingest_decode_320x256"
    benchmark.pedantic(ingest, setup=next_messages, rounds=500, warmup_rounds=20)
    assert synchronizer.counters["observations"] == 520


@pytest.mark.parametrize("encoding", [b"rgb8", b"bgr8"])
def test_decode_a_large_image(benchmark, against, encoding):
    """Compare with a plain copy of the payload."""
    image = np.random.default_rng(0).integers(0, 255, (720, 1280, 3), dtype=np.uint8)
    payload = messages.encode_image(1, "camera", image).replace(b"rgb8", encoding)
    data, out = np.frombuffer(payload, np.uint8), np.zeros_like(image)
    target = np.zeros_like(data)

    def decode():
        messages.decode_image_into(payload, messages.decode_image_header(payload), out)

    benchmark.extra_info["budget"] = f"decode_{encoding.decode()}_1280x720"
    against(lambda: np.copyto(target, data))
    benchmark(decode)
    assert (out == (image if encoding == b"rgb8" else image[..., ::-1])).all()


@pytest.mark.parametrize("n", [100_000])
def test_decode_a_cloud(benchmark, against, n):
    """Compare with a plain copy of the points."""
    points = np.random.default_rng(0).normal(size=(n, 3)).astype(np.float32)
    payload, out = messages.encode_point_cloud(1, "lidar", points), np.zeros((n, 3), np.float32)
    messages.decode_point_cloud_into(payload, out)
    benchmark.extra_info["budget"] = "decode_cloud_100k"
    against(lambda: np.copyto(out, points))
    assert benchmark(messages.decode_point_cloud_into, payload, out) == n


def test_encode_a_map(benchmark, against):
    """Compare with the copy of the cells into bytes, which every message needs."""
    cells = np.zeros((1000, 1000), np.int8)
    benchmark.extra_info["budget"] = "encode_map_1000"
    against(cells.tobytes)
    benchmark(messages.encode_occupancy_grid, 1, Grid(cells, (0.0, 0.0), 0.05))
