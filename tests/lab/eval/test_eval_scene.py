"""Scenes of a simulated robot's depth camera."""

from __future__ import annotations

from small_house import small_house

from edge import names
from edge.lab.eval.closed_loop import ClosedLoop
from edge.tasks.scene.map_scene import scene_of_map
from edge.tasks.scene.pipeline import open_pipeline
from edge.tasks.scene.scene_builder import SceneBuilder


def test_a_scene_description_agrees_with_the_world(tmp_path):
    """Compare described and known objects with the world.

    Each is at an object of its class in the world, and a path leads to it.
    """
    config = small_house(tmp_path, mission={"target": "bed"})
    loop = ClosedLoop(config)
    words = tuple(dict.fromkeys(loop.labels))
    with open_pipeline(config.perception, words, loop.truth) as chain:
        survey = SceneBuilder(chain, config.mapping, config.robot.radius_m)
        while not loop.service.status.done and loop.seconds < 60.0:
            for _ in range(15):
                loop.step()
            survey.add(loop.observe())
    by_survey = survey.scene()
    kept, seen = loop.service.map, loop.observe()
    of_service = scene_of_map(kept.view, seen, kept.tracker.all, config.robot.radius_m)
    for scene in (by_survey, of_service):
        assert "bed" in {obj.label for obj in scene.objects.values()}
        assert scene.regions
        for obj in scene.objects.values():
            x_m, y_m = obj.position_m[:2]
            apart = [
                one.distance_m(x_m, y_m)
                for one in loop.world.objects
                if names.same_name(one.label, obj.label)
            ]
            assert min(apart) < 0.5, obj.caption
            assert obj.nearest_m, obj.caption
