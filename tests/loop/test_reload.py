"""Another configuration in the running service: switched keys, and keys refused by name."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from fnmatch import fnmatch
from itertools import chain, repeat
from pathlib import Path

import pytest
from live_patience import eventually
from simulated import simulated
from tiny_ground import put_network

from edge.config import Config, ConfigError, Section, load, parse
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.reload import LIVE, Reloader
from edge.perception.swap import detector as swapped

BASE = {"loop": {"lockstep": True}, "sim": {"lockstep": True, "step_s": 0.2},
        "mission": {"target": "bed"}}  # fmt: skip


def config(**sections: dict) -> Config:
    merged = {**BASE}
    for name, section in sections.items():
        merged[name] = {**BASE.get(name, {}), **section} if isinstance(section, dict) else section
    return simulated(merged)


class Bench:
    """A service whose loop steps by hand, and a configuration file played by the test."""

    def __init__(self, first: Config) -> None:
        self.closed = ClosedLoop(first)
        self.service = self.closed.service
        self.asked = threading.Event()
        self.reads: Callable[[], Config] = lambda: first
        self.reloader = Reloader(self.service, lambda: self.reads(), self.asked)

    def reload(self, reads: Config | BaseException) -> str:
        def reread() -> Config:
            if isinstance(reads, BaseException):
                raise reads
            return reads

        self.reads = reread
        self.asked.set()
        self.reloader.step(0)
        assert self.reloader.busy

        def over() -> bool:
            self.service.detector_swap.step(0)
            self.reloader.step(0)
            return not self.reloader.busy

        eventually(over)
        return self.reloader.outcome


@pytest.fixture
def bench() -> Bench:
    return Bench(config())


def test_nothing_is_done_unasked(bench):
    bench.reloader.step(0)
    assert not bench.reloader.busy
    assert bench.reloader.outcome == ""


def test_a_reload_requested_during_another_follows_it(bench):
    bench.asked.set()

    def reread() -> Config:
        bench.asked.set()  # the file was changed again when it had been read
        bench.reads = lambda: config(perception={"tau_det": 0.45})
        return config(perception={"tau_det": 0.4})

    bench.reads = reread
    eventually(lambda: bench.reloader.step(0) or bench.service.map.tracker.config.tau_det == 0.4)
    assert not bench.reloader.busy
    eventually(lambda: bench.reloader.step(0) or bench.service.map.tracker.config.tau_det == 0.45)


def test_policy_and_thresholds_are_switched_while_the_robot_drives(bench):
    bench.closed.run(3)
    before, goals = bench.service.perception.policy, len(bench.closed.notes.goals)
    new = config(
        policy={"kind": "nearest_frontier", "r_assoc_m": 0.4},
        perception={"tau_det": 0.45, "confirm_hits": 5},
        mission={"path_limit_m": 4.0},
    )
    outcome = bench.reload(new)
    assert outcome.startswith("switched: ")
    for key in ("policy", "perception.tau_det", "perception.confirm_hits", "mission.path_limit_m"):
        assert key in outcome
    assert type(bench.service.perception.policy).__name__ == "NearestFrontierPolicy"
    assert bench.service.perception.policy is not before
    assert bench.service.map.tracker.config.tau_det == 0.45
    assert bench.service.map.pool.r_assoc_m == 0.4
    bench.closed.run(200)
    assert len(bench.closed.notes.goals) > goals
    assert bench.service.status.phase == "failed"
    assert "4 m" in bench.service.status.reason
    assert f"reload: {outcome}" in bench.closed.notes.events


def test_another_network_is_loaded_before_the_present_one_goes(bench, tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    assert bench.service.ground is None
    one = {"ground": put_network().model_dump()}
    assert bench.reload(config(tasks=one)) == "switched: tasks.ground"
    present = bench.service.ground
    assert present.name == "tiny-ground"
    other = put_network(name="other-ground", ground={"terrain": "lawn"})
    nobody = {"ground": {"model": "nobody"}}
    assert "'nobody'" in bench.reload(config(tasks=nobody))
    assert bench.service.ground is present
    more = {**one, "trajectory": {"max_jump_m": 1.0}}
    assert bench.reload(config(tasks=more)) == "switched: tasks.trajectory.max_jump_m"
    assert bench.service.ground is present
    assert "switched: " in bench.reload(config(tasks={"ground": other.model_dump()}))
    assert bench.service.ground.kinds == ("lawn",)
    assert "switched: " in bench.reload(config())
    assert bench.service.ground is None


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        ({"zenoh": {"prefix": "other"}}, "zenoh.prefix: restart the service to change it"),
        ({"mapping": {"range_m": 4.0}}, "mapping.range_m: restart"),
        ({"mission": {"target": "sofa"}}, "mission.target: give the running service another"),
        ({"perception": {"prior": "none"}}, "perception.prior: restart"),
        ({"perception": {"detector": {"kind": "sim", "seed": 9}}}, "perception.detector.seed: re"),
        ({"policy": {"kind": "search"}, "robot": {"name": "b"}}, "robot.name: restart"),
        ({"policy": {"kind": "nowhere.at:All"}}, "policy.kind: 'nowhere.at:All'"),
    ],
)
def test_a_setting_that_needs_a_restart_is_refused(bench, sections, says, caplog):
    policy, before = bench.service.perception.policy, bench.service.config
    outcome = bench.reload(config(**sections))
    assert [r.getMessage() for r in caplog.records if r.levelname == "WARNING"] == [
        f"reload: {outcome}"
    ]
    assert outcome.startswith("refused, nothing has changed: ")
    assert says in outcome
    assert bench.service.perception.policy is policy
    assert bench.service.config is before
    assert bench.reload(config()) == "nothing has changed"


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (ConfigError("a.yaml: x: unknown key\na.yaml: y: missing"), "x: unknown key; a.yaml: y:"),
        (RuntimeError("bad\x1bness"), "RuntimeError: bad ness"),
        (SystemExit(1), "it raised SystemExit"),  # of a policy's module
    ],
)
def test_a_configuration_that_cannot_be_read_is_refused(bench, error, says):
    outcome = bench.reload(error)
    assert "\n" not in outcome
    assert says in outcome


def test_an_unavailable_detector_refuses_the_whole_reload(bench, cards):
    bench.closed.run(1)
    before = bench.service.config
    detector = {"kind": "onnx", "model": "nobody-has-it"}
    outcome = bench.reload(config(perception={"detector": detector, "tau_det": 0.4}))
    begins = "refused, nothing has changed: perception.detector: the new model was refused: "
    assert outcome.startswith(begins)
    assert "nobody-has-it" in outcome
    assert bench.service.config is before


def test_a_new_detector_is_tried_before_the_switch(bench, monkeypatch):
    """The swapper's own rules are tested with the swapper; here its verdict is played."""
    said = {"state": "idle", "detail": ""}
    asked = []

    def request(self, *words: object) -> None:
        asked.append(words)
        said["state"] = "loading"

    monkeypatch.setattr(swapped.DetectorSwap, "status", lambda self: said)
    monkeypatch.setattr(swapped.DetectorSwap, "request", request)
    new = config(perception={"detector": {"kind": "onnx", "model": "new"}, "tau_det": 0.4})
    bench.reads = lambda: new
    bench.asked.set()
    bench.reloader.step(0)
    eventually(lambda: bench.reloader.step(0) or asked)
    assert asked == [("new", False, 0, new.perception)]
    bench.reloader.step(0)
    assert bench.reloader.busy
    assert bench.service.map.tracker.config.tau_det == 0.3
    said["state"] = "kept"
    bench.reloader.step(0)
    assert bench.reloader.outcome == "switched: perception.detector, perception.tau_det"
    assert bench.service.map.tracker.config.tau_det == 0.4
    assert bench.service.detector_swap.perception is new.perception


@pytest.mark.parametrize(
    ("swap", "at_work", "says"),
    [
        ({"state": "on probation", "model": "new"}, ["new"], "new is still on probation; reload"),
        ({"state": "loading", "model": "new"}, ["sim"], "new is still loading; reload again"),
        ({"state": "kept", "model": "new"}, ["sim", "new"], "new was swapped in during the reload"),
    ],
)
def test_during_a_swap_only_the_detector_cannot_change(bench, monkeypatch, swap, at_work, says):
    """The running model may be rolled back, or may have changed after the reload was prepared."""
    names = chain(at_work, repeat(at_work[-1]))
    monkeypatch.setattr(swapped.DetectorSwap, "status", lambda self: swap)
    monkeypatch.setattr(swapped.DetectorSwap, "running", property(lambda self: next(names)))
    before = bench.service.config
    outcome = bench.reload(config(perception={"detector": {"kind": "onnx", "model": "new"}}))
    assert outcome.startswith(f"refused, nothing has changed: perception.detector: {says}")
    assert bench.service.config is before
    assert bench.reload(config(perception={"tau_det": 0.4})) == "switched: perception.tau_det"


def test_a_changed_detector_is_rebuilt_next_to_the_old():
    first = load("demo").model_dump(exclude={"path"})
    first["loop"]["lockstep"] = first["sim"]["lockstep"] = True
    first["perception"]["isolation"] = "thread"
    first["perception"]["swap"] = {"probation": 4, "budget_ms": 1e6}
    bench = Bench(parse(first))
    before = bench.service.detector_swap._worker.detector
    first["perception"]["detector"]["tau_vl"] = 0.5
    new = parse(first)
    bench.reads = lambda: new
    bench.asked.set()

    def over() -> str:
        bench.closed.step()  # the trial wants images, before it is loaded and after
        bench.service.detector_swap.step(0)
        bench.reloader.step(0)
        return bench.reloader.outcome

    assert eventually(over) == "switched: perception.detector.tau_vl"
    after = bench.service.detector_swap._worker.detector
    assert after is not before
    assert (after.name, after.config.tau_vl) == (before.name, 0.5)
    bench.service.close()


def test_every_live_key_exists():
    for key in LIVE:
        section = config()
        for name in key.split("."):
            assert isinstance(section, Section)
            section = getattr(section, name)


def test_the_page_names_them_all_and_no_other():
    page = (Path(__file__).parents[2] / "docs/service.md").read_text(encoding="utf-8")
    (row,) = (line for line in page.splitlines() if line.startswith("| switched"))
    named = [name.rpartition(".")[2] for name in re.findall(r"`([\w.*]+)`", row)]
    live = [key.rpartition(".")[2] for key in LIVE]
    assert [key for key in live if not any(fnmatch(key, name) for name in named)] == []
    assert [name for name in named if not any(fnmatch(key, name) for key in live)] == []
