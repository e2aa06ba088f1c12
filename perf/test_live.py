"""Benchmark: cost of the live view, without and with a viewer."""

from __future__ import annotations

import base64

import cv2
import numpy as np
import pytest

from edge.config import parse
from edge.host.service_manager import SystemdNotifier
from edge.lab.eval.closed_loop import ClosedLoop
from edge.live.pictures import JPEG_QUALITY, grid_json, shot_json
from edge.live.sink import PERIOD_S, CameraShot, LiveSink
from edge.live.view import LiveView
from edge.loop.monitoring.service_health import ServiceHealth

STEPS = 60


@pytest.fixture(scope="module")
def closed() -> ClosedLoop:
    """Return a closed loop that has driven for some seconds."""
    config = parse({"perception": {"detector": {"kind": "sim"}}, "mission": {"target": "bed"}})
    closed = ClosedLoop(config)
    for _ in range(STEPS):
        closed.step()
    return closed


def test_a_tick_without_viewers(benchmark, closed):
    sink, result = LiveSink(), closed.service.result(1, closed.observe())
    benchmark.extra_info["budget"] = "live_tick_unseen"
    benchmark(sink.tick, result)
    assert sink.snapshot is None


def test_a_tick_with_viewers(benchmark, closed):
    """Measure a tick that gathers the state for viewers.

    There are five such ticks a second. One of five also gathers all objects.
    """
    service, observation = closed.service, closed.observe()
    now_s = 0.0
    sink = LiveSink(lambda: now_s)

    def watch_again():
        nonlocal now_s
        now_s += PERIOD_S
        sink.mark_watched()
        return (service.result(1, observation),), {}

    benchmark.extra_info["budget"] = "live_tick_seen"
    benchmark.pedantic(sink.tick, setup=watch_again, rounds=200)


def test_the_live_now_response(benchmark, closed):
    view = LiveView(closed.config, ServiceHealth(SystemdNotifier({})))
    view.sink.mark_watched()
    view.sink.tick(closed.service.result(1, closed.observe()))
    benchmark.extra_info["budget"] = "live_now"
    assert len(benchmark(view.pages()["/live/now"]).body) > 500


def test_a_map_of_a_house(benchmark, against, closed):
    """Compare with OpenCV's own encoder, at the same compression."""
    grid = closed.service.map.grid.snapshot(50)
    options = [cv2.IMWRITE_PNG_COMPRESSION, 1]
    against(lambda: cv2.imencode(".png", grid.cells.view(np.uint8), options))
    benchmark.extra_info["budget"] = "live_map"
    assert benchmark(grid_json, grid)["png"]


def test_an_image(benchmark, against):
    """Compare with OpenCV's own encoder and base64, which need no conversion of colours."""
    rng = np.random.default_rng(0)
    rgb = cv2.resize(rng.integers(0, 255, (24, 32, 3), np.uint8), (640, 480))
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    against(lambda: base64.b64encode(cv2.imencode(".jpg", rgb, options)[1]))
    benchmark.extra_info["budget"] = "live_camera_640x480"
    assert benchmark(shot_json, CameraShot(1, rgb, (), ()))["jpeg"]
