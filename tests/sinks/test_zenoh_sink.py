"""The sink over a real session: its messages, their rates, and that it never blocks."""

from __future__ import annotations

import json
import time

import pytest
import zenoh
from patience import eventually
from results import observation, parts, result
from ros_messages import from_ros
from simulated import simulated
from task_facts import driving, looking, written

from edge.bus import topics
from edge.bus.session import open_session
from edge.bus.wire import messages
from edge.config import ZenohConfig
from edge.geometry import SE2
from edge.host.ports import free_port
from edge.loop.latency import LatencyRing
from edge.loop.status import status_message
from edge.sinks import zenoh as zenoh_sink
from edge.sinks.zenoh import ZenohSink
from edge.types import Goal, GoalStatus, MissionStatus

PAUSE_S = 0.3  # for messages that must not come; on a slow machine the test sees fewer and passes


def goal(stamp_ns: int, x_m: float = 1.0) -> Goal:
    return Goal(stamp_ns, SE2(x_m, 2.0, 0.5), "frontier", 7, (x_m, 2.5), 0.4, "chair")


class Ears:
    """A subscriber to everything that the service writes."""

    def __init__(self, session: zenoh.Session) -> None:
        self._subscribers = {
            topic.key: session.declare_subscriber(
                ZenohConfig().key(topic.key), zenoh.handlers.RingChannel(1000)
            )
            for topic in topics.ALL
            if topic.writer == "service"
        }

    def hear(self, key: str) -> bytes:
        """Return the next message, once one has arrived."""
        return eventually(self._subscribers[key].try_recv, f"no {key}").payload.to_bytes()

    def rest(self, key: str, pause_s: float = PAUSE_S) -> list[bytes]:
        time.sleep(pause_s)
        heard = []
        while (sample := self._subscribers[key].try_recv()) is not None:
            heard.append(sample.payload.to_bytes())
        return heard


class Clock:
    """Fake of the module `time` in the sink; it stands still unless the test sets it."""

    now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(zenoh_sink, "time", clock)
    return clock


@pytest.fixture
def session():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_session(ZenohConfig(endpoint=endpoint), "listen") as s:
        yield s


@pytest.fixture
def ears(session):
    return Ears(session)


@pytest.fixture
def sink(session, ears):
    sink = ZenohSink(simulated(), session)
    yield sink
    sink.close()


def settle(sink: ZenohSink, ears: Ears) -> None:
    """Wait until the sink's thread has processed all earlier items."""
    sink._put("tick", 0)
    ears.hear("tick")


def test_a_first_tick_sends_everything_once(sink, ears):
    for now_ns in (10**9, 10**9 + 1):
        sink.tick(result(now_ns, observation=observation(now_ns)))
    stamp_ns, grid = messages.decode_occupancy_grid(ears.hear("map"))
    assert (stamp_ns, grid.origin_xy_m, grid.resolution_m) == (10**9, (-1.0, 2.0), 0.05)
    assert grid.cells.tolist() == [[-1, 0], [100, 0]]
    assert json.loads(ears.hear("status")) == json.loads(json.dumps(status_message(result())))
    assert json.loads(ears.hear("latency")) == LatencyRing().report().as_dict()
    mission = json.loads(ears.hear("mission"))
    assert (mission["target"], mission["phase"]) == ("chair", "searching")
    settle(sink, ears)
    assert ears.rest("map") == ears.rest("status", 0.0) == ears.rest("tick", 0.0) == []


def test_rates_follow_the_clock_of_the_loop(session, ears):
    # In lockstep no message is replaced, so all can be counted.
    sink = ZenohSink(simulated({"loop": {"lockstep": True}}), session)
    for k in range(100):  # 10 s at 10 Hz on the loop's clock, in no time
        sink.tick(result(k * 10**8))
    settle(sink, ears)
    assert len(ears.rest("map")) == 20
    assert len(ears.rest("status")) == 10
    assert len(ears.rest("latency")) == 10
    sink.close()


def test_a_clock_set_back_does_not_silence_the_sink(sink, ears):
    sink.tick(result(10**12))
    assert ears.hear("status")
    sink.tick(result(5))
    assert ears.hear("status")


def test_a_goal_is_resent_until_it_is_answered(clock, sink, ears):
    sink.tick(result(goals=(goal(123, x_m=3.0),)))
    settle(sink, ears)
    for clock.now_s in (0.0, 0.6, 1.2):
        stamp_ns, pose = messages.decode_pose_stamped(ears.hear("goal"))
        assert (stamp_ns, pose.x_m, pose.y_m) == (123, 3.0, 2.0)
    assert ears.rest("goal") == []
    sink.tick(result(goal_statuses=(GoalStatus(122, "reached"),)))
    clock.now_s = 1.8
    assert ears.hear("goal")
    sink.tick(result(goal_statuses=(GoalStatus(123, "reached"),)))
    settle(sink, ears)
    clock.now_s = 9.9
    assert ears.rest("goal") == []


def test_an_accepted_goal_is_repeated_every_second(clock, sink, ears):
    sink.tick(result(goals=(goal(123),)))
    assert ears.hear("goal")
    sink.tick(result(goal_statuses=(GoalStatus(123, "accepted"),)))
    settle(sink, ears)
    clock.now_s = 0.6
    assert ears.hear("goal")
    clock.now_s = 1.5
    assert ears.rest("goal") == []
    clock.now_s = 1.7
    assert ears.hear("goal")


def test_a_late_subscriber_gets_the_mission(sink, session, ears):
    sink.tick(result(status=MissionStatus("chair", "reached", "", 12.5, 3.0)))
    ears.hear("mission")
    late = Ears(session)
    assert json.loads(late.hear("mission"))["phase"] == "reached"


def planned(payload: bytes) -> list[float]:
    """Return the x of the poses of a nav_msgs/Path."""
    return [at.pose.position.x for at in from_ros(payload, "nav_msgs/msg/Path").poses]


def test_a_trajectory_is_sent_on_change_and_finally_cleared(clock, sink, session, ears):
    there = written()[1].poses[:, 0].tolist()
    for task in (looking(), driving(0), driving(1), driving(2)):
        sink.tick(result(task=lambda task=task: task))
        settle(sink, ears)
    assert [planned(payload) for payload in ears.rest("trajectory")] == [there]
    late, clock.now_s = Ears(session), 5.1
    assert planned(late.hear("trajectory")) == there
    sink.tick(result())
    assert planned(late.hear("trajectory")) == []


def test_lockstep_sends_everything_in_order(clock, session):
    order = session.declare_subscriber("edge/**", zenoh.handlers.FifoChannel(1000))
    sink = ZenohSink(simulated({"loop": {"lockstep": True}}), session)
    for k in range(3):
        sink.tick(result(k * 10**10, goals=(goal(k),), observation=observation(k)))
    keys = []
    while keys.count("tick") < 3:
        keys.append(str(eventually(order.try_recv).key_expr).removeprefix("edge/"))
    sink.close()
    assert keys == ["goal", "map", "status", "latency", "mission", "tick"] + [
        "goal", "map", "status", "latency", "tick",
    ] * 2  # fmt: skip


def test_a_tick_is_repeated_for_a_late_controller(session, ears):
    sink = ZenohSink(simulated({"loop": {"lockstep": True}}), session)
    sink.tick(result(77, observation=observation(77)))
    ears.hear("tick")
    late = Ears(session)
    assert messages.decode_occupancy_grid(late.hear("map"))[0] == 77
    assert json.loads(late.hear("tick")) == {"stamp": 77}
    sink.close()


def test_an_unencodable_status_does_not_stop_the_sink(sink, ears, caplog):
    sink.tick(result(parts=lambda: {**parts(), "detector": {"score": float("nan")}}))
    eventually(lambda: "status" in caplog.text)  # a newer one would take its place
    sink.tick(result(10**10))
    assert json.loads(ears.hear("status"))["phase"] == "searching"
