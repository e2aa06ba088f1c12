"""A computer's speed: measured once, kept whole, and never taken for another computer's."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from edge.cli.main import main
from edge.host import calibration, machine
from edge.host.calibration import SpeedCalibration


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    return tmp_path


def test_the_calibrate_command_measures_and_saves(capsys, monkeypatch):
    monkeypatch.setattr(calibration, "ROUNDS", 1)
    assert main(["bench", "--calibrate"]) == 0
    kept = calibration.load()
    assert kept.machine == machine.identity()
    assert kept.slowdown == pytest.approx(np.prod(list(kept.parts.values())) ** 0.25)
    assert f"{kept.machine}: {kept}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("slowdown", "words"),
    [
        (1.8, "1.8 times slower than the reference computer"),
        (1.04, "as fast as the reference computer"),
        (0.96, "as fast as the reference computer"),
        (0.5, "2.0 times faster than the reference computer"),
    ],
)
def test_a_slowdown_is_described_in_words(slowdown, words):
    assert str(SpeedCalibration("m", slowdown, {})) == words


GOOD = {"machine": "", "slowdown": 1.8, "parts": {}}


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[]",
        b"[" * 50_000,
        b"\xff",
        json.dumps(GOOD).encode(),  # of another machine
        *(
            json.dumps({**GOOD, "machine": machine.identity(), **bad}).encode()
            for bad in (
                {"slowdown": 0.0}, {"slowdown": float("nan")}, {"slowdown": "fast"}, {"more": 1},
                {"slowdown": 1e9}, {"parts": "x" * (1 << 17)},
            )
        ),
    ],
)  # fmt: skip
def test_an_invalid_calibration_counts_as_none(content):
    calibration.path().write_bytes(content)
    assert calibration.load() is None


def test_a_calibration_that_cannot_be_saved_is_an_error(cache, monkeypatch):
    (cache / "file").touch()
    monkeypatch.setenv("EDGE_CACHE_DIR", str(cache / "file"))
    assert calibration.load() is None
    with pytest.raises(calibration.CalibrationError, match=r"calibration\.json: cannot be written"):
        calibration.save(SpeedCalibration("m", 1.0, {}))


@pytest.mark.parametrize("share", [0.0, 0.4, 0.6, 1.0])
def test_the_flood_fill_agrees_with_opencv(share):
    free = np.random.default_rng(1).random((65, 65)) < share
    free[32, 32] = True
    seen, queue = np.zeros_like(free), np.zeros(free.size, np.int32)
    n = calibration.flood_fill(free, seen, queue)
    _, parts = cv2.connectedComponents(free.astype(np.uint8), connectivity=4)
    expected = parts == parts[32, 32]
    np.testing.assert_array_equal(seen, expected)
    assert n == expected.sum()
