"""Messages that are well formed, with finite numbers that no sensor has: none raises anything.

In process, from the payload to the end of a tick, or to the controller's command.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from absurd_sensors import ABSURD, HEIGHT, STAMP_NS, WIDTH, batches, changed
from simulated import simulated

from edge.bus import topics
from edge.bus.wire import DecodeError, messages
from edge.geometry import Grid, se2_of
from edge.lab.eval.closed_loop import ClosedLoop
from edge.lab.motion.controller import Controller
from edge.loop.status import status_message
from edge.sources.decoder import CdrDecoder
from edge.sources.synchronizer import TimeSynchronizer


@pytest.mark.parametrize("mode", ["depth", "cloud"])
def test_no_number_breaks_decoding_or_a_tick(mode):
    config = simulated({
        "mission": {"target": "bed"},
        "mapping": {"input": mode},
        "perception": {"back_projection": mode, "min_hits": 1},
        "sensors": {"lidar": {"z_m": 0.5}, "camera": {"width_px": WIDTH, "height_px": HEIGHT}},
    })  # fmt: skip
    service, ticks = ClosedLoop(config).service, 0
    for said in batches():
        clock = SimpleNamespace(now_ns=0)
        source = TimeSynchronizer(config, clock=lambda clock=clock: clock.now_ns)
        decoder = CdrDecoder(source, clock=lambda clock=clock: clock.now_ns)
        del said[topics.SEGMENTATION]  # the closed loop's own is looked at
        for topic, payload in said.items():
            decoder.offer(topic, payload)
        clock.now_ns = int(config.source.wait_s * 1e9) + 1
        if (observation := source.poll()) is not None:
            ticks += 1
            service.tick(observation, observation.stamp_ns)
            observation.release()
            service.idle(observation.stamp_ns + 2 * 10**9, source.odometry.newest_pose)
            assert status_message(service.result())["loop"]["failed"] == 0
    assert ticks > 100


@pytest.fixture
def controller() -> Controller:
    return Controller(simulated({"mission": {"target": "bed"}}))


def taken(decode: Callable, payload: bytes):
    try:
        return decode(payload)
    except DecodeError:
        return None


@pytest.mark.parametrize("number", [0.111, 0.222, 0.333, 0.444, 0.555, 0.0625, 0.777, 0.888, 0.999])
@pytest.mark.parametrize("value", ABSURD)
def test_no_number_breaks_the_controller(controller, number, value):
    """Odometry, goal and map with one number changed."""
    pose = np.eye(4)
    pose[:3, 3] = 0.111, 0.222, 0.333
    goal = np.eye(4)
    goal[:2, 3] = 0.777, 0.888
    odometry = messages.encode_odometry(STAMP_NS, pose, 0.444, 0.555)
    order = messages.encode_pose_stamped(STAMP_NS, se2_of(goal))
    empty = Grid(np.zeros((40, 40), np.int8), (-0.999, -0.999), 0.0625)
    grid = messages.encode_occupancy_grid(STAMP_NS, empty)
    for code, sign in (("d", 1), ("d", -1), ("f", 1)):
        old = struct.pack(f"<{code}", sign * number)
        odometry, order, grid = (
            changed(payload, code, sign * number, value) if old in payload else payload
            for payload in (odometry, order, grid)
        )
    if (found := taken(messages.decode_occupancy_grid, grid)) is not None:
        with suppress(ValueError):  # what it says of a map that it does not take
            controller.on_map(found[1])
    if (sent := taken(messages.decode_pose_stamped, order)) is not None:
        controller.on_goal(*sent)
    if (said := taken(messages.decode_odometry, odometry)) is not None:
        for step in range(3):
            now_ns = STAMP_NS + step * 50_000_000
            at = se2_of(said.T_map_base)
            command, _ = controller.step(at, said.v_mps, said.w_radps, now_ns)
            assert math.isfinite(command.v_mps + command.w_radps)
