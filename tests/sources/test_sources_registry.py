"""Sources by name, and plugin sources."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from fake_zenoh import Flooded
from simulated import simulated

from edge import launch
from edge.config import ConfigError
from edge.geometry import CameraModel
from edge.host.ports import free_port
from edge.launch import open_service
from edge.loop.runner import loop
from edge.loop.status import status_message
from edge.sources import find_source
from edge.sources.zenoh import ZenohSource
from edge.types import Observation


class Mine:
    """Minimal `edge.loop.source.Source`: an empty floor, at a given rate."""

    epoch, pose, inbox = 0, None, SimpleNamespace(poll=list, overruns=0)

    def __init__(self, rate_hz: int) -> None:
        self.rate_hz, self.counters, self._seq = rate_hz, {}, 0

    def wait(self, timeout_s: float) -> bool:
        return True

    def poll(self) -> Observation:
        self._seq += 1
        camera, depth = CameraModel.from_hfov(64, 64, 1.3), np.full((64, 64), 2.0, np.float32)
        rgb, stamp_ns = np.zeros((64, 64, 3), np.uint8), int(self._seq * 1e9 / self.rate_hz)
        return Observation(self._seq, stamp_ns, np.eye(4), rgb=rgb, depth_m=depth, camera=camera)

    def close(self) -> None: ...


class Deaf(Mine):
    """Hears no controller."""

    inbox = None


class Broken(Mine):
    def __init__(self, config) -> None:
        raise OSError(f"no camera\nat {config.sensors.camera.rate_hz:g} Hz")


def configured(kind: str, **options):
    source, zenoh = {"kind": kind, "options": options}, f"tcp/127.0.0.1:{free_port()}"
    data = {"source": source, "zenoh": {"endpoint": zenoh}, "loop": {"lockstep": True}}
    return simulated({**data, "mission": {"target": "bed"}}, "f.yaml")


def test_zenoh_is_the_default_source():
    source = find_source(simulated())(config=simulated(), session=Flooded("", ()))
    assert isinstance(source, ZenohSource)


def test_a_plugin_source_drives_the_loop(monkeypatch):
    monkeypatch.setattr(launch, "warm_up", lambda config, progress: None)
    config, stop, ticks = configured(f"{__name__}:Mine", rate_hz=5), threading.Event(), []
    with open_service(config, []) as running:
        loop(running, stop, each=lambda: ticks.append(1) or (len(ticks) == 10 and stop.set()))
        assert running.service.latency.report().tick.count == 10
        status = status_message(running.service.result())
    assert (status["loop"]["failed"], status["loop"]["overruns"]["sensors"]) == (0, 0)
    assert status["inputs"] == {"state": "ok", "detail": "", "topics": {}}, "it has no table"


def names(*cases):
    return pytest.mark.parametrize(("kind", "options", "says"), cases)


@names(
    ("zenho", {}, r"kind: unknown 'zenho' \(choices: zenoh, ros2, zmq, camera, or module:Class\)"),
    ("zenoh", {"rate": 3}, r"options\.rate: unknown option \(choices: none\)$"),
    ("zmq", {"adress": "x"}, r"options\.adress: unknown option \(did you mean 'address'\?\)$"),
    (
        f"{__name__}:Mine",
        {"rate": 3},
        r"options\.rate: unknown option \(did you mean 'rate_hz'\?\)$",
    ),
    (f"{__name__}:Mine", {"": 3}, r"options\.: unknown option \(choices: rate_hz\)$"),
    ("zmq", {"address": 5555}, r"options\.address: expected a text, got 5555$"),
    (f"{__name__}:Mine", {"rate_hz": "5 Hz"}, r"options\.rate_hz: expected a number, got '5 Hz'$"),
    (f"{__name__}:Mine", {"rate_hz": True}, r"options\.rate_hz: expected a number, got True$"),
    ("no_such_module:A", {}, "kind: 'no_such_module:A' cannot be imported: Mod.* PYTHONPATH"),
    ("edge.sources:Nothing", {}, "kind: 'edge.sources:Nothing' cannot be imported: Attr"),
    ("math:pi", {}, "kind: math:pi is no source: 3.14.* is not a callable object"),
    ("subprocess:Popen", {"args": ["false"]}, r"kind: .* is no source: it has no close\(\)"),
    ("os:system", {"command": "false"}, "kind: os:system is no source: it is no class"),
    ("builtins:dict", {}, "kind: builtins:dict is no source: no signature found"),
    (f"{__name__}:Mine", {}, "options: missing a required argument: 'rate_hz'"),
)
def test_an_unusable_source_is_an_error_of_one_line(kind, options, says):
    with pytest.raises(ConfigError, match=rf"^f\.yaml: source\.{says}") as caught:
        find_source(configured(kind, **options))
    assert "\n" not in str(caught.value)


@names(
    (f"{__name__}:Deaf", {"rate_hz": 5}, r"kind: .*:Deaf is no source: it has no inbox\.poll\(\)$"),
    (f"{__name__}:Broken", {}, "options: .*:Broken: OSError: no camera at 30 Hz$"),
)
def test_an_invalid_plugin_source_is_an_error_of_one_line(kind, options, says):
    config = configured(kind, **options)
    with pytest.raises(ConfigError, match=rf"^f\.yaml: source\.{says}"):
        find_source(config)(config=config, session=None)
