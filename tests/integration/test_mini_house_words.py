"""Every word of the small detector, in its house.

Each is found in plain view, for every default background.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from edge import names
from edge.config import parse
from edge.errors import UserError
from edge.geometry import SE2
from edge.lab.sim.base import WorldObject, free_poses
from edge.lab.sim.sensors import CameraRig
from edge.lab.sim.worlds import load_world
from edge.perception.factory import make_detector
from edge.perception.tracking.back_projection import BackProjector
from edge.perception.tracking.fusion import InstanceFusion
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.object_tracker import ObjectTracker
from edge.types import Observation

BACKGROUND = (
    "armchair", "backpack", "ball", "bathtub", "bed", "bookshelf", "box", "cabinet", "chair",
    "coffee table", "desk", "dresser", "lamp", "laptop", "microwave", "nightstand", "oven",
    "picture", "plant", "refrigerator", "rug", "sink", "sofa", "stool", "suitcase", "table",
    "television", "toilet", "trash can", "tv stand", "vase", "wardrobe", "washing machine",
)  # fmt: skip
LOOKS = 8
PLAIN_VIEW = 0.006
"""Share of the image that an object fills."""


@pytest.fixture(scope="module")
def house():
    """Return configuration, world, camera and poses."""
    pytest.importorskip("onnxruntime")
    detector = {"kind": "onnx", "model": "mini-house-256x320-int8-cpu", "threads": 1}
    config = parse({"perception": {"detector": {**detector, "background": BACKGROUND}}}, "<test>")
    world = load_world(config)
    poses = free_poses(world, 600, 5, config.robot.radius_m)
    try:
        return (
            config,
            world,
            CameraRig(config, world),
            poses,
            make_detector(config.perception, ["bed"]),
        )
    except UserError as error:
        pytest.skip(str(error))


def looks(house, obj: WorldObject) -> Iterator[Observation]:
    """Return views of an object in plain sight, from several sides."""
    _, _, rig, poses, _ = house
    seq = 0
    for pose in poses:
        if seq == LOOKS or not 0.9 < obj.distance_m(pose.x_m, pose.y_m) < 2.8:
            continue
        x_m, y_m, _ = obj.center_m
        seen_from = SE2(pose.x_m, pose.y_m, math.atan2(y_m - pose.y_m, x_m - pose.x_m))
        rig.look(seen_from)
        if (rig.ids == obj.id).mean() < PLAIN_VIEW:
            continue
        seq += 1
        yield Observation(
            seq, seq * 100_000_000, seen_from.matrix(), rig.rgb.copy(), rig.depth_m.copy(),
            rig.model, rig.T_base_camera,
        )  # fmt: skip


@pytest.mark.parametrize("word", BACKGROUND)
def test_a_background_object_is_found_at_its_place(house, word):
    config, world, _, _, detector = house
    detector.set_prompts([word])
    objects, lifter = ObjectTracker(config.perception), BackProjector(config.perception)
    tracker = InstanceTracker(config.perception)
    fusion = InstanceFusion(tracker, objects)
    obj = next(o for o in world.objects if names.same_name(o.label, word))
    for observation in looks(house, obj):
        found = detector.detect(observation)
        lifted, around = lifter.back_project(found)
        objects.update(lifted, around)
        fusion.update(lifted, observation.stamp_ns)
        fusion.expire(observation, found.prompts)
    sure = tracker.of(word, only_confirmed=True, with_contested=False)
    assert min(obj.distance_m(*i.center_m[:2].tolist()) for i in sure) < 0.5, tracker.all
