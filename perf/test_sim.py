"""Benchmark: cost of the simulated sensors."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from edge.config import Lidar, parse
from edge.geometry import CameraModel, se3, to_optical
from edge.lab.sim.base import LidarRays, World, free_poses
from edge.lab.sim.worlds import load_world

SIM = {"perception": {"detector": {"kind": "sim"}}}

CAMERA = CameraModel.from_hfov(320, 256, math.radians(75.0))
AWS = Path(__file__).resolve().parents[2] / "shared" / "worlds" / "aws_small_house"


class Views:
    """Camera images and LiDAR scans of a world, from one free pose after another."""

    def __init__(self, world: World, lidar: Lidar | None = None) -> None:
        mount = to_optical(se3(0.1, 0.0, 0.6, pitch_rad=math.radians(5.0)))
        mast = se3(z_m=0.5, pitch_rad=math.radians(23.0))
        poses = [pose.matrix() for pose in free_poses(world, 20, seed=1, radius_m=0.2)]
        self._world, self._turn = world, 0
        self._cameras, self._lidars = [T @ mount for T in poses], [T @ mast for T in poses]
        self._rgb, self._depth = np.empty((256, 320, 3), np.uint8), np.empty((256, 320), np.float32)
        self._ids = np.empty((256, 320), np.uint16)
        self._fan = LidarRays.of(lidar or Lidar())
        self._ranges = np.empty(self._fan.directions.shape[:2], np.float32)

    def render(self) -> None:
        self._turn = (self._turn + 1) % len(self._cameras)
        T = self._cameras[self._turn]
        self._world.render(CAMERA, T, self._rgb, self._depth, self._ids)

    def cast(self) -> None:
        self._turn = (self._turn + 1) % len(self._lidars)
        self._world.cast(self._fan, self._lidars[self._turn], self._ranges)


@pytest.fixture(scope="module")
def house() -> World:
    return load_world(parse(SIM))


def measure(benchmark, work, budget: str) -> None:
    benchmark.extra_info["budget"] = budget
    benchmark.pedantic(work, rounds=100, warmup_rounds=20)


def test_render_house(benchmark, house: World):
    measure(benchmark, Views(house).render, "sim_render_320x256")


def test_lidar_house(benchmark, house: World):
    measure(benchmark, Views(house).cast, "sim_lidar_16x720")


def test_move_an_object(benchmark, house: World):
    measure(benchmark, lambda: house.move(11, 4.6, 2.9), "sim_move_object")


def test_render_mesh(benchmark):
    pytest.importorskip("embreex", reason="needs the extra `worlds`")
    if not AWS.is_dir():
        pytest.skip("the AWS house is not there")
    section = {
        "kind": "mesh",
        "mesh": str(AWS / "small_house_zup.glb"),
        "objects": str(AWS / "small_house.objects.json"),
    }
    world = load_world(parse({**SIM, "sim": {"world": section}}))
    measure(benchmark, Views(world).render, "sim_render_mesh_320x256")
