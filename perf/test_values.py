"""Benchmark: update of the value maps, compared with VLFM's on the same frames, by turns."""

from __future__ import annotations

import itertools
import math
import statistics
import time

import cv2
import numpy as np
import pytest
from test_mapping import CAMERA, MAPPING, T_BASE_CAMERA, explored_map, frames

from edge.geometry import optical_yaw_rad
from edge.loop.warmup import warm_mapping, warm_values
from edge.types import Observation

TARGETS = ("bed", "chair", "sofa", "toilet")
SCORE = np.array([0.2, 0.3, 0.4, 0.5], np.float32)
ROUNDS = 150


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    warm_mapping(MAPPING)
    warm_values(MAPPING)


class VlfmValueMap:
    """Twin of VLFM's ValueMap.update_map, step by step (bdaiinstitute/vlfm, weighted average).

    A template of confidences, cos^2 over the field of view, is made once. Each update cuts the
    visible part out of a copy of the template, turns it by the camera's yaw, and places it in an
    empty map of full size. Then it averages the entire value map with this map, for each channel.
    """

    def __init__(self, channels: int, size: int = 1000, pixels_per_m: int = 20) -> None:
        self.confidence = np.zeros((size, size), np.float32)
        self.value = np.zeros((size, size, channels), np.float32)
        self.pixels_per_m = pixels_per_m
        self._template = np.zeros((0, 0), np.float32)

    def update(self, score, depth_m, T, fov_rad, range_m) -> None:
        new = self._place(self._rotate(self._visible_part(depth_m, fov_rad, range_m), T), T)
        new[(new < 0.35) & (new < self.confidence)] = 0.0
        with np.errstate(invalid="ignore"):
            total = self.confidence + new
            old_share, new_share = self.confidence / total, new / total
        channels = self.value.shape[2]
        old_shares = np.repeat(old_share[..., None], channels, axis=2)
        new_shares = np.repeat(new_share[..., None], channels, axis=2)
        self.value = self.value * old_shares + score * new_shares
        self.confidence = self.confidence * old_share + new * new_share
        self.value = np.nan_to_num(self.value)
        self.confidence = np.nan_to_num(self.confidence)

    def _cone(self, fov_rad: float, range_m: float) -> np.ndarray:
        if self._template.size == 0:
            half = int(range_m * self.pixels_per_m)
            cone = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
            between = [math.degrees(side * fov_rad / 2) + 90 for side in (-1, 1)]
            cv2.ellipse(cone, (half, half), (half, half), 0, *between, 1, -1)
            row, column = np.indices(cone.shape)
            angle = np.arctan2(abs(column - half), abs(row - half)) / (fov_rad / 2) * math.pi / 2
            self._template = (cone * (0.25 + 0.75 * np.cos(angle) ** 2)).astype(np.float32)
        return self._template.copy()

    def _visible_part(self, depth_m: np.ndarray, fov_rad: float, range_m: float) -> np.ndarray:
        """Return the cone without the cells behind the farthest return of each column."""
        shown = np.clip(depth_m, 0.0, range_m) / range_m  # VLFM is given such an image
        farthest = shown.max(axis=0) * range_m
        mask = self._cone(fov_rad, range_m)
        angle = np.linspace(-fov_rad / 2, fov_rad / 2, len(farthest))
        middle = mask.shape[0] / 2
        x = (farthest * self.pixels_per_m + middle).astype(int)
        y = (farthest * np.tan(angle) * self.pixels_per_m + middle).astype(int)
        last = mask.shape[0] - 1
        rim = np.concatenate([[[0, last]], np.stack([y, x], axis=1), [[last, last]]])
        return cv2.drawContours(mask, [rim], -1, 0, -1)

    def _rotate(self, mask: np.ndarray, T: np.ndarray) -> np.ndarray:
        h, w = mask.shape
        turn = cv2.getRotationMatrix2D((w // 2, h // 2), -math.degrees(optical_yaw_rad(T)), 1.0)
        return cv2.warpAffine(mask, turn, (w, h), borderValue=0)

    def _place(self, mask: np.ndarray, T: np.ndarray) -> np.ndarray:
        new, side = np.zeros_like(self.confidence), len(mask)
        middle = len(new) // 2
        row = int(T[0, 3] * self.pixels_per_m) + middle - side // 2
        column = int(-T[1, 3] * self.pixels_per_m) + middle - side // 2
        new[row : row + side, column : column + side] = mask
        return new


def test_the_reference_is_a_value_map():
    """Check the twin: values ahead of the camera, none behind it and behind pillars."""
    theirs, (depth, T, _) = VlfmValueMap(1), frames()[0]
    for score in (0.2, 0.6):
        theirs.update(np.array([score]), depth, T, CAMERA.hfov_rad, 5.0)
    middle = len(theirs.value) // 2
    assert theirs.value[middle + 20, middle, 0] == pytest.approx(0.4, abs=0.01)
    assert theirs.value[middle - 20, middle, 0] == 0.0
    assert 0.002 < (theirs.confidence > 0).mean() < 0.02


def test_four_channels_against_one_of_vlfm(benchmark):
    """Measure all steps from a depth image of 480 x 640 to the map of 1000 x 1000 cells."""
    benchmark.extra_info["budget"] = "value_update_4_channels"
    m = explored_map(1000)
    m.values.set_targets(TARGETS)
    theirs, views = VlfmValueMap(1), itertools.cycle(frames())
    took_s = []

    def reference() -> None:
        """Update the twin with the next frame, and time it; then `step` uses this frame."""
        depth, T, pose = step.view = next(views)
        step.seen = Observation(
            0, 0, pose.matrix(), depth_m=depth, camera=CAMERA, T_base_camera=T_BASE_CAMERA
        )
        began_s = time.thread_time()
        theirs.update(np.float64(SCORE[:1]), depth, T, CAMERA.hfov_rad, MAPPING.range_m)
        took_s.append(time.thread_time() - began_s)

    def step() -> None:
        m.values.write_view(m.values.range_profile(step.seen), TARGETS, SCORE)

    benchmark.pedantic(step, setup=reference, rounds=ROUNDS, warmup_rounds=10)
    benchmark.extra_info["reference_ms"] = 1e3 * statistics.median(took_s[-ROUNDS:])
    assert m.values.weight.any(axis=(0, 1)).all()


def test_values_of_100_frontiers(benchmark):
    """Benchmark: cost of reading frontier values in a tick of a value policy."""
    benchmark.extra_info["budget"] = "value_best_100"
    m = explored_map(1000)
    m.values.set_targets(TARGETS)
    for depth, _, pose in frames():
        observation = Observation(
            0, 0, pose.matrix(), depth_m=depth, camera=CAMERA, T_base_camera=T_BASE_CAMERA
        )
        m.values.write_view(m.values.range_profile(observation), TARGETS, SCORE)
    xy_m = np.random.default_rng(1).uniform(-5, 5, (100, 2)).astype(np.float32)
    xy_m.flags.writeable = False
    out = np.zeros(100, np.float32)
    benchmark(m.values.best, 2, xy_m, 100, 0.5, out)
    assert np.nanmax(out) == pytest.approx(0.4, abs=1e-3)
