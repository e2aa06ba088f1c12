"""The map's checkpoint: restored, a service goes on as if it had never been away."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from patience import PATIENCE_S
from simulated import simulated

from edge.config import Config
from edge.geometry import SE2
from edge.lab.eval.closed_loop import ClosedLoop, RunLog
from edge.loop.checkpoints import map_checkpoint
from edge.loop.checkpoints.checkpoint import ServiceCheckpoint
from edge.loop.checkpoints.map_checkpoint import MAP, MapParts, StampedPose, make_map, state_of
from edge.loop.service import Service
from edge.mapping.tiles import TileCopier
from edge.mapping.window import Window
from edge.memory import known_objects
from edge.perception.factory import make_detector
from edge.perception.worker import DetectorWorker
from edge.policies import make_policy
from edge.types import Goal, GoalStatus

POLICIES = ("nearest_frontier", "search", "hvl")


@pytest.fixture(autouse=True)
def whole_field(monkeypatch):
    """Grow the reach field within one tick: else two services grow theirs from other poses."""
    monkeypatch.setattr("edge.mapping.grid.REACH_CELLS_PER_TICK", 1_000_000)


def config(policy: str = "search", **sections: dict) -> Config:
    data = {
        "loop": {"lockstep": True},
        "sim": {"lockstep": True, "step_s": 0.2},
        "mission": {"instruction": "F toilet", "translator": {"kind": "ltl"}},
        "mapping": {"extent_m": 25.0},
        "policy": {"kind": policy},
        "perception": {"prior": "none"},
    }
    for name, section in sections.items():
        data[name] = {**data.get(name, {}), **section}
    return simulated(data)


class Run(ClosedLoop):
    """A robot, the service that drives it, and perhaps one that sees the same and is not heard."""

    def __init__(self, path: Path, settings: Config) -> None:
        super().__init__(settings, colour=False)
        self.path, self.second = path, None
        self.service = self.another()

    def another(self, settings: Config | None = None) -> Service:
        """Return a service that reads the checkpoint."""
        settings = settings or self.config
        checkpoint = ServiceCheckpoint(settings, self.path, None)
        spec = checkpoint.saved_spec() or self.service.mission.spec
        detector = make_detector(settings.perception, spec.prompts, truth=self.truth)
        worker = DetectorWorker(detector, inline=True)
        policy = make_policy(settings.policy)
        return Service(settings, spec, worker, policy, [self.notes], checkpoint)

    def ticks(self, n: int) -> Run:
        for _ in range(n):
            self.step()
        return self

    def killed(self, settings: Config | None = None) -> Run:
        """Replace the service by a new one."""
        self.service.checkpoint.close()
        self.service = self.another(settings)
        return self

    def both(self) -> tuple[Service, Service]:
        """Tick the driving service, then the second one with the same observation."""
        observation, now_ns = self.observe(), self.drive.motion.stamp_ns
        self._seq -= 1
        seen = len(self.notes.goal_statuses)
        self.step()
        self.second.tick(replace(observation), now_ns)
        for answer in self.notes.goal_statuses[seen:]:
            self.hear(answer)
        return self.service, self.second

    def hear(self, answer: GoalStatus) -> None:
        goal = self.second.goals.goal
        if goal is not None and self.service.goals.goal is not None:
            mine = answer.stamp_ns == self.service.goals.goal.stamp_ns
            stamp_ns = goal.stamp_ns if mine else answer.stamp_ns
            self.second.on_goal_status(replace(answer, stamp_ns=stamp_ns))


def goal_fields(goal: Goal | None) -> tuple | None:
    return None if goal is None else (goal.kind, goal.candidate_id, goal.pose, goal.target)


def begun(path: Path, ticks: int, settings: Config) -> Run:
    """Save a run after some ticks; return it with a second service that loaded the checkpoint."""
    run = Run(path, settings).ticks(ticks)
    run.service.checkpoint.close()
    run.second = run.another()
    # Its content is not trusted.
    run.second.publisher._sinks = [RunLog()]
    return run


@settings(max_examples=2)
@given(st.sampled_from(POLICIES), st.integers(1, 120))
@example("hvl", 90)
@example("search", 98)  # an object takes the row of one that is gone
def test_goals_are_those_of_a_service_that_never_stopped(tmp_path_factory, policy, ticks):
    """Compare with a service that never stopped, bit for bit, on the same further observations.

    Frontiers, ids, paths, gains, scores, objects and goals are equal.
    """
    run = begun(tmp_path_factory.mktemp("saved") / "m.json", ticks, config(policy))
    before = run.service.goals.goal
    for i in range(25):
        one, other = run.both()
        # The controller repeats its last answer, which went to the killed service.
        assume(i > 0 or before is None or one.goals.goal is before)
        n = one.map.grid.frontiers.n
        assert n == other.map.grid.frontiers.n
        np.testing.assert_array_equal(
            one.map.grid.frontiers.xy_m[:n], other.map.grid.frontiers.xy_m[:n]
        )
        mine, its = one.map.pool.candidates, other.map.pool.candidates
        assert mine.n == its.n
        for name in ("id", "kind", "first_seen_ns", "path_m", "gain_m2", "blocked", "confidence"):
            a, b = getattr(mine, name), getattr(its, name)
            np.testing.assert_array_equal(a[: mine.n], b[: its.n], name)
        np.testing.assert_array_equal(one.perception.scores, other.perception.scores)
        assert goal_fields(one.goals.goal) == goal_fields(other.goals.goal)
        assert [(i.id, i.score, i.hits, i.state, i.last_seen_ns) for i in one.map.tracker.all] == [
            (i.id, i.score, i.hits, i.state, i.last_seen_ns) for i in other.map.tracker.all
        ]
        assert one.map.objects.read_only.n == other.map.objects.read_only.n
    nowhere = StampedPose(SE2(0, 0, 0), 0, 0)
    mine, its = (
        state_of(MapParts(s.map, s.goals.chooser, s.perception.policy), nowhere, "", (), "")
        for s in (one, other)
    )
    assert mine.state == its.state
    assert mine.arrays.keys() == its.arrays.keys()
    for name, array in mine.arrays.items():
        if not name.startswith("rooms/"):  # the two survey the rooms in other ticks
            np.testing.assert_array_equal(array, its.arrays[name], name)
    np.testing.assert_array_equal(one.map.grid.coverage.looks, other.map.grid.coverage.looks)
    for layer, (a, b) in zip(
        one.map.grid.layers._fields,
        zip(one.map.grid.layers, other.map.grid.layers, strict=True),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b, layer)
    other.checkpoint.close()


def idle(checkpoint: ServiceCheckpoint) -> None:
    """Wait for the writer's thread."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not checkpoint.map.writer.idle:
        assert time.monotonic() < deadline_s
        time.sleep(0.001)


def test_the_checkpoint_is_one_tick_and_under_five_seconds_old(tmp_path, monkeypatch):
    """This holds although copying takes several ticks, while the robot drives."""
    steps, step = [], TileCopier.step

    def few(copier: TileCopier, window: Window, planes: tuple, most: int) -> bool:
        steps.append(step(copier, window, planes, 17))  # one more than an update writes here
        return steps[-1]

    monkeypatch.setattr(TileCopier, "step", few)
    run = Run(tmp_path / "m.json", config())
    path, raw, written = tmp_path / "m.json.map", {}, set()
    for _ in range(120):
        now_ns = run.drive.motion.stamp_ns
        run.ticks(1)
        grid = run.service.map.grid
        raw[now_ns] = grid.layers.raw.copy()
        idle(run.service.checkpoint)
        if path.exists():
            saved = MAP.decode(path.read_bytes())
            saved_ns = saved.state.now_ns
            assert now_ns - saved_ns <= 5 * 10**9
            if saved_ns not in written:
                written.add(saved_ns)
                again = make_map(saved, run.config)
                np.testing.assert_array_equal(again.layers.raw, raw[saved_ns])
    assert len(written) >= 4
    assert not all(steps)
    run.service.checkpoint.close()


def test_an_unwritable_disk_stops_only_the_checkpoint(tmp_path, caplog):
    run = Run(tmp_path / "m.json", config())
    (tmp_path / ".m.json.map.tmp").mkdir()  # the temporary file cannot be written
    for _ in range(40):
        run.ticks(1)
        idle(run.service.checkpoint)
    assert run.service.checkpoint.status()["problem"] == "Is a directory"
    assert sum("not written" in message for message in caplog.messages) == 1
    assert run.service.error_boundary.failed == 0
    assert run.service.goals.goal is not None
    (tmp_path / ".m.json.map.tmp").rmdir()
    run.killed()
    run.service.tick(run.observe(), run.drive.motion.stamp_ns)
    assert run.service.map.grid.known_m2 > 10
    run.service.checkpoint.close()


def test_bumps_and_discarded_candidates_survive_a_restart(tmp_path):
    run = Run(tmp_path / "m.json", config()).ticks(40)
    service, now_ns = run.service, run.drive.motion.stamp_ns
    pose = run.drive.motion.odometry
    service.map.grid.bumps.close(pose, pose.ahead(0.6), 0.2, now_ns)
    service.map.pool.discarded.add(0, 7, (1.0, 2.0), now_ns + 10**10)
    service.goals.chooser.search.left.append((3.0, 4.0))
    cells = service.map.grid.layers.raw == 255
    run.killed()
    run.service.tick(run.observe(), run.drive.motion.stamp_ns)
    grid = run.service.map.grid
    assert cells.any()
    np.testing.assert_array_equal(grid.layers.raw == 255, cells)
    assert grid.bumps.closed_m == service.map.grid.bumps.closed_m
    assert run.service.map.pool.state_dict()["discarded_id"].tolist() == [7]
    assert (3.0, 4.0) in run.service.goals.chooser.search.left
    grid.bumps.expire(now_ns + 10**13)
    assert not (grid.layers.raw == 255).any()
    run.service.checkpoint.close()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, True),
        ({"stamp_s": -1}, False),
        ({"moved_m": 3.0}, False),
        ({"turned_rad": 2.5}, False),
        ({"boot": "another"}, False),
        ({"boot": "another", "moved_m": 3.0, "stamp_s": -1, "localised": True}, True),
    ],
)
def test_the_map_is_restored_only_in_the_same_frame(tmp_path, monkeypatch, change, expected):
    settings = config(
        source={"localised": change.get("localised", False)},
        mission={"instruction": "F (toilet & F start)"},
    )
    run = Run(tmp_path / "m.json", settings).ticks(20)
    known_m2 = run.service.map.grid.known_m2
    if "boot" in change:
        monkeypatch.setattr(map_checkpoint, "boot_id", lambda: change["boot"])
    run.killed()
    seen, now_ns = run.observe(), run.drive.motion.stamp_ns
    at = run.drive.motion.odometry
    pose = SE2(
        at.x_m + change.get("moved_m", 0.0), at.y_m, at.yaw_rad + change.get("turned_rad", 0.0)
    )
    stamp_ns = seen.stamp_ns + int(change.get("stamp_s", 0) * 1e9)
    run.service.tick(replace(seen, T_map_base=pose.matrix(), stamp_ns=stamp_ns), now_ns)
    taken = run.service.map.grid.known_m2 > 0.9 * known_m2
    assert taken is expected
    assert any("restored" in text for text in run.notes.events) is expected
    assert run.service.mission.sets.lost == (frozenset() if expected else {"start"})
    run.service.checkpoint.close()


def test_a_clock_set_back_shifts_all_stored_times(tmp_path):
    run = Run(tmp_path / "m.json", config(source={"localised": True})).ticks(10)
    now_ns = run.drive.motion.stamp_ns
    run.service.map.pool.discarded.add(0, 7, (1.0, 2.0), now_ns + 5 * 10**9)
    run.killed()
    saved = MAP.decode((tmp_path / "m.json.map").read_bytes())
    observation = replace(run.observe(), stamp_ns=10**8)
    run.service.tick(observation, 10**8)
    back_ns = saved.state.stamp_ns - 10**8
    frontiers = (saved.arrays[f"candidates/{name}"] for name in ("id", "first_seen_ns"))
    first_ns = dict(zip(*frontiers, strict=True))
    now = run.service.map.pool.state_dict()
    lasting = [i for i, k in enumerate(now["id"]) if k in first_ns]
    assert lasting
    assert all(now["first_seen_ns"][i] == first_ns[now["id"][i]] - back_ns for i in lasting)
    until_ns = now["discarded_until_ns"].tolist()
    assert until_ns[0] - 10**8 == pytest.approx(5 * 10**9, abs=10**9)
    assert (run.service.map.pool.candidates.first_seen_ns <= 10**8).all()
    assert all(i.last_seen_ns <= 10**8 for i in run.service.map.tracker.all)
    run.service.checkpoint.close()


def test_an_ended_mission_leaves_its_map_to_the_next(tmp_path):
    run = Run(tmp_path / "m.json", config()).ticks(40)
    run.service.mission.finish("failed", "by order", run.drive.motion.stamp_ns)
    run.ticks(1)
    known_m2, n_objects = run.service.map.grid.known_m2, len(run.service.map.objects.read_only.id)
    remembered = len(known_objects(run.service.map.objects.read_only, 0, 2))
    run.killed()
    assert run.service.checkpoint.saved is None
    run.service.tick(run.observe(), run.drive.motion.stamp_ns)
    assert any(f"and {remembered} objects from the" in event for event in run.notes.events)
    assert remembered > len(run.service.map.tracker), "context words are remembered, too"
    assert run.service.map.grid.known_m2 >= known_m2 > 0
    assert len(run.service.map.objects.read_only.id) == n_objects
    # The new mission has looked only at the view of this one image.
    assert run.service.map.grid.coverage.looks.max(initial=0) <= 1
    run.service.checkpoint.close()


@pytest.mark.parametrize(
    ("mapping", "aside", "part"),
    [
        ({"extent_m": 40.0}, False, "mapping.extent_m has changed"),
        ({"extent_m": 14.0}, False, "mapping.extent_m has changed"),
        ({"inflation_m": 0.3}, False, "restored map"),
        ({"resolution_m": 0.1}, True, "made with mapping.resolution_m 0.05, which is now 0.1"),
        ({"obstacle_max_m": 1.5}, True, "made with mapping.obstacle_max_m 1, which is now 1.5"),
    ],
)
def test_another_map_is_adapted_or_set_aside(tmp_path, caplog, mapping, aside, part):
    path = tmp_path / "m.json"
    run = Run(path, config()).ticks(40)
    raw = run.service.map.grid.snapshot()
    with caplog.at_level(logging.INFO):
        run.killed(config(mapping=mapping))
        run.service.tick(run.observe(), run.drive.motion.stamp_ns)
    assert part in "\n".join([*caplog.messages, *run.notes.events])
    assert (tmp_path / "m.json.map.damaged-1").exists() is aside
    if not aside:
        x0, y0 = raw.origin_xy_m
        occupied = np.argwhere(raw.cells == 100) * 0.05 + (y0 + 0.025, x0 + 0.025)
        grid = run.service.map.grid
        assert any(grid.state_at(x, y) == 100 for y, x in occupied)
        assert run.service.goals.goal is not None
    run.service.checkpoint.close()


def test_a_localised_robot_restores_its_map_after_a_jump(tmp_path):
    run = Run(tmp_path / "m.json", config(source={"localised": True})).ticks(40)
    known_m2 = run.service.map.grid.known_m2
    run.killed()
    run.service.tick(run.observe(), run.drive.motion.stamp_ns)
    run.service.on_pose_jump(run.drive.motion.stamp_ns)
    assert run.service.map.grid.known_m2 == 0
    run.service.tick(run.observe(), run.drive.motion.stamp_ns)
    assert run.service.map.grid.known_m2 >= 0.99 * known_m2
    run.service.checkpoint.close()
