"""Start-up assumptions of the loop, and a service's first mission."""

from __future__ import annotations

import gc
import json
import logging
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from simulated import simulated
from tiny_ground import put_network

from edge import launch
from edge.config import Config, TasksConfig, WriterModel
from edge.errors import ConfigError, Stopped
from edge.host.checkpoint import Checkpoint, save
from edge.host.ports import free_port
from edge.launch import open_service
from edge.mission.checkpoint import MISSION, MissionState
from edge.mission.translate import TranslationError

UNFINISHED = MissionState(
    "go to the bed", "F bed", "grammar", "reach the bed", (), (), (), (), "bed", "exploring", "",
    False, 1.0, 0.5,
)  # fmt: skip

COMPILED_IN_THE_LOOP = """
import json, sys
from numba.core.registry import CPUDispatcher
from edge.lab.eval.closed_loop import ClosedLoop
from simulated import simulated
from edge.loop.warmup import warm_up

SERVICE = ("edge.mapping", "edge.perception", "edge.policies", "edge.bus.wire", "edge.geometry")

def signatures():
    return {
        f"{d.py_func.__module__}.{d.py_func.__name__}": len(d.signatures)
        for name, module in list(sys.modules.items()) if name.startswith("edge.")
        for d in vars(module).values()
        if isinstance(d, CPUDispatcher) and d.py_func.__module__.startswith(SERVICE)
    }

config = simulated({"mission": {"target": "television"}, "loop": {"lockstep": True},
                    "sim": {"lockstep": True}})
warm_up(config)
before = signatures()
loop = ClosedLoop(config).run(60)
after = signatures()
late = [name for name, n in after.items() if n > before.get(name, 0)]
print(json.dumps([loop.service.status.phase, sum(after.values()), late]))
"""


def test_nothing_is_compiled_once_the_loop_runs():
    """In a process of its own: here, other tests have compiled everything already."""
    tests = Path(__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", COMPILED_IN_THE_LOOP],
        capture_output=True,
        text=True,
        cwd=tests,
        check=True,
    )
    phase, kernels, late = json.loads(done.stdout.splitlines()[-1])
    assert phase == "reached"
    assert kernels > 20
    assert late == []


@pytest.fixture(autouse=True)
def as_before():
    """Check that the process-wide settings end with the service."""
    interval_s, frozen = sys.getswitchinterval(), gc.get_freeze_count()
    yield
    assert sys.getswitchinterval() == interval_s
    assert gc.get_freeze_count() <= frozen  # Python 3.12 itself begins with some


def config(**mission: object) -> Config:
    return simulated({"zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}"}, "mission": mission})


@pytest.mark.parametrize(
    ("asked", "formula", "expected"),
    [
        (None, None, "go to the bed"),
        ("go to the sofa", None, "go to the sofa"),
        (None, "F sofa", "F sofa"),
    ],
)
def test_an_unfinished_mission_resumes_unless_another_is_requested(
    tmp_path, asked, formula, expected
):
    save(tmp_path / "mission.json", Checkpoint(UNFINISHED), MISSION)
    settings = config(instruction="go to the sofa", checkpoint=str(tmp_path / "mission.json"))
    with open_service(settings, [], asked, formula) as running:
        assert running.service.mission.spec.translation.instruction == expected


def test_a_service_has_the_network_that_names_ground(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    tasks = TasksConfig(ground=put_network())
    with open_service(config().model_copy(update={"tasks": tasks}), []) as running:
        assert running.service.ground.name == "tiny-ground"


def test_missions_are_prepared_with_the_configuration_in_use(monkeypatch):
    prepares, make_handlers = [], launch.request_handlers

    def request_handlers(service, prepare, problems):
        prepares.append(prepare)
        return make_handlers(service, prepare, problems)

    monkeypatch.setattr(launch, "request_handlers", request_handlers)
    with open_service(config(), []) as running:
        with pytest.raises(TranslationError):
            prepares[0](task="fly")
        tasks = TasksConfig(planner=WriterModel())
        running.service.config = running.service.config.model_copy(update={"tasks": tasks})
        assert prepares[0](task="fly").translation.backend == "model"


NOWHERE = "no_such_module:A"


@pytest.mark.parametrize(
    ("section", "named"),
    [("policy", {"kind": NOWHERE}), ("source", {"kind": NOWHERE}), ("sinks", [NOWHERE])],
)
def test_plugins_are_looked_up_before_anything_starts(monkeypatch, section, named):
    monkeypatch.setattr(launch, "prepare_mission", None)
    settings = simulated({section: named})
    with pytest.raises(ConfigError, match=section), open_service(settings, []):
        raise AssertionError


@pytest.mark.parametrize(
    ("sinks", "played", "warns"),
    [
        ([], False, True),
        (["foxglove"], False, True),
        (["zenoh"], False, False),
        (["foxglove", "ros2"], False, False),
        ([], True, False),
    ],
)
def test_sinks_that_no_motion_controller_hears_are_warned_of(sinks, played, warns, caplog):
    stop, settings = threading.Event(), simulated({"sinks": sinks})
    stop.set()
    make_source = (lambda **given: None) if played else None
    with (
        pytest.raises(Stopped),
        open_service(settings, [], stop=stop, make_source=make_source),
    ):
        raise AssertionError
    warned = "sinks: no zenoh or ros2 sink: no motion controller receives goals" in caplog.text
    assert warned is warns


STEPS = ["prepare_mission", "make_detector", "make_scorers", "warm_up"]


@pytest.mark.parametrize("last", STEPS)
def test_a_stop_during_the_start_ends_after_the_step(monkeypatch, caplog, last):
    caplog.set_level(logging.INFO, "edge")
    stop, made = threading.Event(), []

    def noting(name, step):
        def note(*args, **kwargs):
            made.append(name)
            if name == last:
                stop.set()
            return step(*args, **kwargs)

        return note

    monkeypatch.setattr(launch, "warm_up", lambda config, progress: None)
    for name in STEPS:
        monkeypatch.setattr(launch, name, noting(name, getattr(launch, name)))
    with pytest.raises(Stopped), open_service(config(target="bed"), [], stop=stop):
        raise AssertionError
    assert made == STEPS[: STEPS.index(last) + 1]
    logged = [r.getMessage() for r in caplog.records if r.name == "edge"]
    assert logged == ["stopped during the start, before the service was ready"]
