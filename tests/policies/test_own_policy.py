"""A plugin policy: the code of docs/policies.md, and its error messages."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from simulated import simulated

from edge.config import ConfigError, MappingConfig
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.warmup import warm_up
from edge.mapping.grid import RollingMap
from edge.mapping.view import MapView
from edge.policies import make_policy
from edge.policies.base import INSTANCE

PAGE = (Path(__file__).parents[2] / "docs" / "policies.md").read_text(encoding="utf-8")
LOCKSTEP = {"loop": {"lockstep": True}, "sim": {"lockstep": True, "step_s": 0.2}}


def block(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.S)
    return found


def test_the_page_names_only_attributes_of_the_map():
    (row,) = re.findall(r"^\| `map` \|.*$", PAGE, re.M)
    names = [name.split(".")[0] for name in re.findall(r"`([\w.]+)`", row)]
    view = MapView(RollingMap(MappingConfig()))
    assert [name for name in names if not hasattr(view, name)] == ["map", "targets"]


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Write a module into a folder of the import path."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_policy", raising=False)
    yield lambda code: (tmp_path / "my_policy.py").write_text(code)
    sys.modules.pop("my_policy", None)


def test_the_page_adds_a_policy_without_touching_another_file(written):
    code = block("python")
    assert len(code.splitlines()) <= 40
    written(code)
    data = {**LOCKSTEP, **yaml.safe_load(block("yaml")), "mission": {"target": "sofa"}}
    config = simulated(data)
    warm_up(config)
    loop = ClosedLoop(config)
    assert (loop.service.perception.policy.turning, config.policy.switch_margin) == (0.8, 0.2)
    loop.run(60)
    assert loop.service.status.phase == "reached", loop.service.status
    assert len(loop.service.perception.policy.been) > 1
    loop.service.on_pose_jump(loop.drive.motion.stamp_ns)
    assert len(loop.service.perception.policy.been) == 0


SEES = """
import numpy as np
class Spy:
    def __init__(self): self.seen, self.resets = [], []
    def reset(self, why): self.resets.append(why)
    def score(self, context):
        self.seen.append((context, context.candidates.id[: context.candidates.n].copy()))
        return np.ones(context.candidates.n)
"""


def test_a_policy_sees_a_read_only_context(written):
    written(SEES)
    small = {"extent_m": 8.0, "range_m": 2.5}
    instruction = {"instruction": "F television & F bed", "translator": {"kind": "ltl"}}
    data = {**LOCKSTEP, "policy": {"kind": "my_policy:Spy"}, "mapping": small}
    config = simulated({**data, "mission": instruction})
    loop = ClosedLoop(config)
    policy, states = loop.service.perception.policy, {}
    while loop.service.goals.goal is None or loop.service.goals.goal.kind != "instance":
        before, window = dict(states), loop.service.map.grid.window.origin
        loop.step()
        context, _ = policy.seen[-1]
        grid, res = context.map, context.map.resolution_m
        assert context.observation.rgb is not None
        assert context.targets[context.active] == context.target == loop.service.mission.target
        # Cells with another state lie in the reported changed rectangle.
        x0, y0, x1, y1 = context.changed
        for x in range(-40, 40, 3):
            for y in range(-40, 40, 3):
                states[x, y] = grid.state_at((x + 0.5) * res, (y + 0.5) * res)
                if grid.window.origin == window and states[x, y] != before.get((x, y), -1):
                    assert (x0 <= x < x1, y0 <= y < y1) == (True, True)
    assert any(context.detections is not None for context, _ in policy.seen)
    x, y = grid.window.cell_of(context.pose.x_m, context.pose.y_m)
    cell = y % grid.window.n, x % grid.window.n
    assert grid.layers.raw[cell] == 1  # free, where the robot stands
    c = context.candidates
    for shown in (*grid.layers, grid.frontiers.xy_m, c.xy_m, c.id, c.blocked):
        with pytest.raises(ValueError, match="read-only"):
            shown[:] = 0
    assert grid.frontiers.n == loop.service.map.grid.frontiers.n > 0
    assert c.n == loop.service.map.pool.candidates.n
    for writes in ("update_depth", "bumps", "coverage"):
        assert not hasattr(grid, writes)
    assert (c.confidence[: c.n] > 0).tolist() == (c.kind[: c.n] == INSTANCE).tolist()
    new = np.setdiff1d(policy.seen[-1][1], policy.seen[-2][1])
    assert len(new) < c.n  # candidates last


def test_a_policy_is_reset_with_the_reason(written):
    from edge.mission.spec import prepare

    written(SEES)
    data = {**LOCKSTEP, "policy": {"kind": "my_policy:Spy"}}
    small = {"extent_m": 8.0, "range_m": 2.5}
    loop = ClosedLoop(simulated({**data, "mapping": small, "mission": {"target": "refrigerator"}}))
    resets, now_ns = loop.service.perception.policy.resets, loop.drive.motion.stamp_ns
    loop.step()
    assert resets == []
    loop.service.begin(prepare(loop.config.mission, "go to the refrigerator"), now_ns)
    loop.service.on_pose_jump(now_ns)
    assert resets == ["mission", "pose"]
    while "map rolled" not in resets:
        loop.step()
    assert loop.seconds < 60.0


def test_an_unusable_policy_is_refused_with_its_key():
    unusable = {"kind": "subprocess:Popen", "options": {"args": ["false"]}}
    says = r"^f\.yaml: policy\.kind: subprocess:Popen is no policy: it has no score\(\)$"
    with pytest.raises(ConfigError, match=says):
        make_policy(simulated({"policy": unusable}).policy, "f.yaml")


def test_ours_are_made_by_their_kind():
    for kind in ("hvl", "nearest_frontier"):
        assert make_policy(simulated({"policy": {"kind": kind}}).policy)
