"""Messages that are well formed, with finite numbers that no sensor has: none raises anything.

In process, from the payload to the end of a tick, or to the controller's command.
"""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from absurd_sensors import HEIGHT, WIDTH, batches
from simulated import simulated

from edge.bus import topics
from edge.lab.eval.closed_loop import ClosedLoop
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
