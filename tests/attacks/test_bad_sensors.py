"""A live service, a sane robot, and a broken driver beside it: the service ticks and answers."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from absurd_sensors import ABSURD, NUMBERS, STAMPS_NS, batch, changed, scan
from live_patience import eventually
from live_service import Live, live

from edge.bus import topics
from edge.bus.topics import Topic
from edge.loop.error_boundary import DEGRADED_AFTER

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["depth", "cloud"])
def service(request) -> Iterator[Live]:
    with live(
        {"mapping": {"input": request.param}, "perception": {"back_projection": request.param}}
    ) as it:
        yield it


def bad(topic: Topic) -> list[bytes]:
    """Messages of a topic that are well formed, with a number that cannot be."""
    sane = scan() if topic is topics.SCAN else batch(time.time_ns())[topic]
    return [
        changed(sane, code, number, value)
        for its, code, number in NUMBERS
        for value in ABSURD
        if its is topic
    ]


@pytest.mark.parametrize("topic", sorted({topic for topic, *_ in NUMBERS}, key=lambda t: t.key))
def test_absurd_numbers_cost_neither_ticks_nor_answers(service, topic):
    before = service.failures
    for payload in bad(topic):
        for _ in range(3):
            service.send({topic: payload})
        service.wait(ticks=1)  # so that each gets into a tick
    service.is_resumed()
    assert service.failures == before


@pytest.mark.parametrize(
    "topic", [topics.ODOMETRY, topics.DEPTH, topics.RGB, topics.CLOUD], ids=lambda t: t.key
)
def test_stamps_from_the_ends_of_time_cost_neither_ticks_nor_answers(service, topic):
    before = service.failures
    for stamp_ns in STAMPS_NS:
        service.send({topic: batch(stamp_ns)[topic]})
        service.is_resumed()
    assert service.failures == before


@pytest.mark.parametrize(
    ("number", "value"), [(41.5, 1e300), (42.5, 1e30), (41.5, 1e-300), (31.25, 1e18)]
)
def test_a_camera_that_cannot_be_is_refused_and_the_one_before_stays(service, number, value):
    counters = service.running.source.counters
    before, camera = counters["malformed"], service.running.source._synchronizer._camera
    payload = changed(batch()[topics.CAMERA_INFO], "d", number, value)

    def refused() -> bool:  # a ring of one: the sane camera's own message may displace it
        service.send({topics.CAMERA_INFO: payload})
        return counters["malformed"] > before

    eventually(refused, "nothing was refused")
    assert service.running.source._synchronizer._camera == camera
    service.is_resumed()


def test_a_stage_that_fails_without_end_is_degraded_until_it_goes_well(service, monkeypatch):
    said, before = service.statuses, service.running.service.error_boundary.failed

    def broken(*_) -> None:
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(service.running.service.map, "gather", broken)
        eventually(lambda: said[-1]["loop"]["state"] == "degraded", "it never said degraded")
        assert said[-1]["loop"]["failed"] >= before + DEGRADED_AFTER
        assert "candidates: ZeroDivisionError" in said[-1]["loop"]["failures"]
    eventually(lambda: said[-1]["loop"]["state"] == "ok", "it never recovered")
    service.is_resumed()
    report = service.running.service.latency.report()
    assert report.stage("candidates").drops >= DEGRADED_AFTER
