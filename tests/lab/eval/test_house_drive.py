"""The drive through the built-in house that `edge bench` records."""

from __future__ import annotations

from simulated import simulated

from edge.bus import topics
from edge.lab.eval import house_drive as drives

SENSORS = {"camera": {"width_px": 32, "height_px": 24, "rate_hz": 1.0}, "odometry_hz": 10.0}


def stamps_ns(seconds: float) -> list[int]:
    config = simulated({"sensors": SENSORS})
    messages = drives.house_drive(config, seconds)
    return [stamp_ns for topic, stamp_ns, _ in messages if topic is topics.ODOMETRY]


def test_a_drive_of_no_time_has_no_messages():
    assert stamps_ns(0.0) == []


def test_a_drive_continues_after_its_last_stop(monkeypatch):
    monkeypatch.setattr(drives, "_STOPS", 1)
    stamps = stamps_ns(40.0)
    assert round(1e-9 * (stamps[-1] - stamps[0]), 1) == 39.9
