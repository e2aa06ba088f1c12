"""The recording that `edge bench` plays, and its figures."""

from __future__ import annotations

import threading

import pytest
from simulated import simulated

from edge.bus import topics
from edge.errors import Stopped, UserError
from edge.lab.bench import service as bench
from edge.sources import recording

SMALL = {"width_px": 64, "height_px": 48, "rate_hz": 15}
CONFIG = simulated({"sensors": {"camera": SMALL}})


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    return tmp_path


def test_a_stopped_recording_leaves_nothing(cache):
    stop = threading.Event()
    stop.set()
    with pytest.raises(Stopped):
        bench.ensure_recording(CONFIG, 1.0, stop)
    assert not [path for path in cache.rglob("*") if path.is_file()]


def test_a_stop_before_the_service_is_ready_is_obeyed(tmp_path):
    stop = threading.Event()
    stop.set()
    with pytest.raises(Stopped):
        bench.run_bench(CONFIG, tmp_path / "not.mcap", 1.0, stop)


def test_the_recording_is_made_once_and_is_the_same_again(cache, tmp_path, monkeypatch):
    path = bench.ensure_recording(CONFIG, 2.0)
    made_ns = path.stat().st_mtime_ns
    assert bench.ensure_recording(CONFIG, 2.0) == path
    assert path.stat().st_mtime_ns == made_ns
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "other"))
    again = bench.ensure_recording(CONFIG, 2.0)
    assert list(recording.read(again)) == list(recording.read(path))


def test_the_service_is_measured_on_a_recording():
    path = bench.ensure_recording(CONFIG, 3.0)
    figures = bench.run_bench(CONFIG, path, 1.5, threading.Event(), 1.0)
    assert figures["latency"]["tick"]["count"] > 1
    assert figures["counters"]["observations"] > 1
    verdicts = figures["verdicts"]
    assert 50 < verdicts["resident memory"][0] < 2000
    assert verdicts["ready after"][0] > 1.0


def test_a_service_with_a_lidar_is_measured_on_its_recording():
    lidar = {"rings": 16, "columns": 90, "vfov_deg": 60, "rate_hz": 10}
    config = simulated(
        {"sensors": {"camera": SMALL, "lidar": lidar}, "mapping": {"input": "cloud"}}
    )
    path = bench.ensure_recording(config, 3.0)
    assert sum(message.topic is topics.CLOUD for message in recording.read(path)) == 30
    figures = bench.run_bench(config, path, 1.5, threading.Event(), 1.0)
    assert figures["counters"]["observations"] > 1


def test_nothing_measured_is_an_error(tmp_path):
    path = tmp_path / "empty.mcap"
    recording.record_messages(path, [])
    with pytest.raises(
        UserError, match=r"searched for camera/rgb, camera/depth.* the recording has no topics"
    ):
        bench.run_bench(CONFIG, path, 0.5, threading.Event())
