"""The sink over a real router: goals to a Nav2 and back, drawings, and late subscribers."""

from __future__ import annotations

import math
import struct
import threading
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from nav2 import ACTION, Nav2
from patience import PATIENCE_S, eventually
from results import result
from ros_messages import from_ros
from ros_router import ours, router, zenoh_settings
from simulated import simulated
from task_facts import driving as driven_task
from task_facts import written

from edge.bus.ros2 import names
from edge.bus.ros2.names import BRIDGE, RMW_ZENOH, dialect_of
from edge.bus.ros2.node import Ros2Node
from edge.errors import UserError
from edge.geometry import SE2
from edge.mapping.zones import ZonePolygons
from edge.memory import KnownObject
from edge.sinks import navigate
from edge.sinks.navigate import NavigateToPoseClient
from edge.sinks.ros2 import PathRing, Ros2Sink
from edge.sources.goal_status import GoalStatusInbox
from edge.types import Detections, Goal, GoalStatus, Instance, Observation

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def goal(stamp_ns: int, x_m: float = 1.0) -> Goal:
    return Goal(stamp_ns, SE2(x_m, 2.0, 0.5), "frontier", 7, (x_m, 2.5), 0.4, "chair")


def driving(stamp_ns: int, x_m: float = 1.0):
    """Return a tick in which a goal is sent."""
    one = goal(stamp_ns, x_m)
    return result(goals=(one,), goal=one)


@pytest.fixture(scope="module")
def port():
    with router() as port:
        yield port


@pytest.fixture
def theirs(port):
    with ours(port) as session:
        yield session


@pytest.fixture
def session(port):
    with ours(port) as session:
        yield session


@pytest.fixture
def make(port, session):
    made = []

    def sink(**settings) -> Ros2Sink:
        config = simulated({"sinks": ["ros2"], "ros2": settings})
        config = config.model_copy(update={"zenoh": zenoh_settings(port)})
        made.append(Ros2Sink(config, session))
        return made[-1]

    sink.made = made
    yield sink
    for one in made:
        one.close()


@pytest.fixture
def answers(port, session):
    """Return the goal statuses that the loop would receive."""
    inbox = GoalStatusInbox(session, zenoh_settings(port))
    heard: list[GoalStatus] = []

    def after(n: int) -> list[GoalStatus]:
        def enough():
            heard.extend(inbox.poll())
            return len(heard) >= n

        eventually(enough)
        return heard

    yield after
    inbox.close()


@pytest.fixture
def nav2(theirs):
    nav2 = Nav2(theirs)
    yield nav2
    nav2.close()


def first_goal(nav2: Nav2) -> bytes:
    eventually(lambda: nav2.goals)
    goal_id = nav2.goals[-1][0]
    eventually(lambda: nav2.asked(goal_id))
    return goal_id


@pytest.mark.parametrize(
    ("distribution", "status", "state", "reason"),
    [("humble", SUCCEEDED, "reached", ""), ("jazzy", SUCCEEDED, "reached", ""),
     ("kilted", ABORTED, "failed", "aborted by Nav2"),
     ("humble", CANCELED, "failed", "cancelled by Nav2"),
     ("jazzy", 0, "failed", "unknown to Nav2")],
)  # fmt: skip
def test_a_goal_and_its_end(make, theirs, answers, distribution, status, state, reason):
    nav2 = Nav2(theirs, distribution)
    make().tick(driving(123, x_m=3.0))
    goal_id = first_goal(nav2)
    assert (nav2.goals[0][1].pose.pose.position.x, len(nav2.goals)) == (3.0, 1)
    assert nav2.goals[0][1].pose.header.frame_id == "map"
    assert answers(1) == [GoalStatus(123, "accepted")]
    nav2.end(goal_id, status)
    _, end = answers(2)
    assert (end.stamp_ns, end.state) == (123, state)
    assert reason in end.reason
    nav2.close()


@pytest.mark.parametrize("via", ["bridge", "adapter"])
def test_a_goal_through_a_peer_without_types(make, theirs, answers, via):
    sink = make(via=via)
    sink.tick(driving(9))
    nav2 = Nav2(theirs, "jazzy", dialect=dialect_of(via, "edge"))
    goal_id = first_goal(nav2)
    nav2.feed_back(goal_id, 1, 2.0)
    assert answers(2)[1].reason == "1 recoveries, 2.0 m left"
    nav2.end(goal_id, ABORTED, 103)
    assert answers(3)[2] == GoalStatus(9, "failed", "aborted by Nav2 (error 103)")
    nav2.close()


def test_a_refused_goal_has_failed(make, nav2, answers):
    nav2.accepts = False
    make().tick(driving(5))
    assert answers(1) == [GoalStatus(5, "failed", "refused by navigate_to_pose")]


def at_place(stamp_ns: int, name: str):
    one = Goal(stamp_ns, SE2(1.0, 2.0, 0.5), "place", 0, (1.0, 2.0), 1.0, name)
    return result(goals=(one,), goal=one)


@pytest.mark.parametrize(
    ("status", "end"),
    [(SUCCEEDED, GoalStatus(8, "reached")),
     (ABORTED, GoalStatus(8, "failed", "aborted by Nav2 (error 902): no dock"))],
)  # fmt: skip
def test_a_goal_at_a_dock_goes_to_the_docking_server(make, nav2, theirs, answers, status, end):
    docking = Nav2(theirs, "kilted", action="DockRobot")
    sink = make(docks={"bay 2": "bay_2"})
    sink.tick(driving(6))
    first_goal(nav2)
    sink.tick(at_place(7, "bay two"))
    goal_id = first_goal(docking)
    eventually(lambda: nav2.cancelled)
    asked = docking.goals[0][1]
    assert (asked.use_dock_id, asked.dock_id) == (True, "bay_2")
    assert (asked.max_staging_time, asked.navigate_to_staging_pose) == (1000.0, True)
    sink.tick(at_place(8, "bay two"))  # its cell has moved: the robot docks on
    assert answers(3)[-1] == GoalStatus(8, "accepted")
    docking.end(goal_id, status, *((902, "no dock") if status == ABORTED else ()))
    assert answers(4)[-1] == end
    assert len(docking.goals) == 1
    docking.close()


def test_a_goal_that_leaves_the_dock_cancels_the_docking(make, nav2, theirs):
    docking = Nav2(theirs, "jazzy", action="DockRobot")
    sink = make(docks={"dock": "bay_1"})
    sink.tick(at_place(7, "dock"))
    goal_id = first_goal(docking)
    sink.tick(at_place(8, "shelf"))
    first_goal(nav2)
    assert eventually(lambda: docking.cancelled) == [goal_id]
    docking.close()


@pytest.mark.parametrize("status", [SUCCEEDED, ABORTED])
def test_a_docked_robot_undocks_before_it_drives(make, nav2, theirs, answers, status):
    docking = Nav2(theirs, "jazzy", action="DockRobot")
    undocking = Nav2(theirs, "jazzy", action="UndockRobot")
    sink = make(docks={"dock": "bay_1"})
    sink.tick(at_place(7, "dock"))
    docking.end(first_goal(docking), SUCCEEDED)
    assert answers(2)[-1] == GoalStatus(7, "reached")
    sink.tick(driving(8))
    goal_id = first_goal(undocking)
    sink.tick(driving(9))  # a better goal: it undocks on
    assert answers(4)[-1] == GoalStatus(9, "accepted")
    assert nav2.goals == []
    undocking.end(goal_id, status, 903)
    if status == SUCCEEDED:
        nav2.end(first_goal(nav2), SUCCEEDED)
        assert answers(6)[-1] == GoalStatus(9, "reached")
        sink.tick(driving(10))
        eventually(lambda: len(nav2.goals) == 2)
    else:
        assert answers(5)[-1] == GoalStatus(9, "failed", "aborted by Nav2 (error 903)")
    assert len(undocking.goals) == 1
    docking.close()
    undocking.close()


@pytest.mark.parametrize("more", [{"via": "adapter"}, {"goals": "topic"}])
def test_docking_needs_actions(make, more):
    with pytest.raises(UserError, match=r"docks: needs ros2\.goals: navigate_to_pose"):
        make(docks={"dock": "bay_1"}, **more)


def test_a_goal_waits_for_a_late_nav2(make, theirs, answers, caplog, monkeypatch):
    monkeypatch.setattr(navigate, "PATIENCE_S", 0.0)
    make().tick(driving(5))
    eventually(
        lambda: "waiting for the action server /navigate_to_pose: is Nav2 running?" in caplog.text
    )
    nav2 = Nav2(theirs)
    assert answers(1) == [GoalStatus(5, "accepted")]
    nav2.close()


def test_a_new_goal_takes_the_place_of_the_old(make, nav2, answers, monkeypatch):
    monkeypatch.setattr(navigate, "REPLACED_S", PATIENCE_S)
    sink = make()
    sink.tick(driving(1))
    old = first_goal(nav2)
    sink.tick(driving(2))
    eventually(lambda: len(nav2.goals) == 2)
    new = first_goal(nav2)
    nav2.end(old, ABORTED)  # as Nav2 reports a replaced goal
    nav2.say_status(old, ABORTED)
    nav2.end(new, SUCCEEDED)
    assert [(a.stamp_ns, a.state) for a in answers(3)] == [
        (1, "accepted"), (2, "accepted"), (2, "reached"),
    ]  # fmt: skip
    assert nav2.cancelled == []


@pytest.mark.parametrize("accepts", [True, False])
def test_an_old_goal_still_driven_to_is_cancelled(make, nav2, answers, accepts, monkeypatch):
    monkeypatch.setattr(navigate, "REPLACED_S", 0.0)
    sink = make()
    sink.tick(driving(1))
    old = first_goal(nav2)
    nav2.accepts = accepts
    sink.tick(driving(2))
    assert eventually(lambda: nav2.cancelled) == [old]
    assert answers(2)[1].state == ("accepted" if accepts else "failed")


def test_nowhere_to_go_cancels_and_is_not_answered(make, nav2, answers):
    sink = make()
    sink.tick(driving(1))
    goal_id = first_goal(nav2)
    answers(1)
    sink.tick(result())
    assert eventually(lambda: nav2.cancelled) == [goal_id]
    nav2.end(goal_id, CANCELED)
    sink.tick(driving(2))
    assert [(a.stamp_ns, a.state) for a in answers(2)] == [(1, "accepted"), (2, "accepted")]


def test_a_stop_cancels_its_goal_and_all_of_others_once(make, nav2):
    sink = make()
    sink.tick(driving(1))
    goal_id = first_goal(nav2)
    for _ in range(3):
        sink.tick(result(stopped="button"))
    assert eventually(lambda: len(nav2.cancelled) >= 2 and nav2.cancelled) == [goal_id, bytes(16)]


def test_goals_and_stops_that_wait_keep_their_order(make, monkeypatch):
    entered, go_on, delivered = threading.Event(), threading.Event(), []

    def deliver(self, message):
        entered.set()
        assert go_on.wait(PATIENCE_S)
        delivered.append((message[0], message[1] and message[1].stamp_ns))

    monkeypatch.setattr(Ros2Sink, "_deliver", deliver)
    sink = make()
    sink._limiter = SimpleNamespace(take_turn=lambda *_: False)
    sink.tick(driving(1))
    assert entered.wait(PATIENCE_S)
    sink.tick(driving(2))
    sink.tick(result(stopped="button"))
    sink.tick(driving(3))
    go_on.set()
    eventually(lambda: ("goal", 3) in delivered)
    assert delivered == [("goal", 1), ("goal", 2), ("goal", None), ("stop", None), ("goal", 3)]


def test_a_start_while_stopped_cancels_leftover_goals(make, nav2):
    make().tick(result(stopped="button"))
    assert eventually(lambda: nav2.cancelled) == [bytes(16)]


class FakeReply:
    """A pending reply; a test answers it, or loses the answer (`done`)."""

    def __init__(self, done: bool) -> None:
        self.done, self.answer = done, None

    def poll(self):
        answer, self.answer = self.answer, None
        self.done |= answer is not None
        return answer


class FakeNode:
    """A node whose only action is gone while `has_server` is False."""

    def __init__(self) -> None:
        self.has_server, self.calls, self.statuses = True, {}, []

    def client(self, service, *_):
        calls = self.calls.setdefault(service.rsplit("/", 1)[1], [])

        def call(payload):
            if self.has_server:
                calls.append((payload, FakeReply(done=False)))
            return calls[-1][1] if self.has_server else FakeReply(done=True)

        return SimpleNamespace(has_server=lambda: self.has_server, call=call)

    def subscription(self, topic, *_):
        if not topic.endswith("status"):
            return SimpleNamespace(take=list)
        return SimpleNamespace(take=lambda: [self.statuses.pop()] if self.statuses else [])

    @property
    def cancelled(self) -> list[bytes]:
        return [payload[4:20] for payload, _ in self.calls["cancel_goal"]]


ACCEPTED = b"\0\1\0\0\1" + bytes(11)
REJECTED = b"\0\1\0\0\1" + bytes(7)  # an answer to a cancellation


@pytest.mark.parametrize("is_stop", [False, True], ids=["cancel", "stop"])
@pytest.mark.parametrize("lost", ["the answer to the goal", "the action", "the cancellation"])
def test_a_cancellation_is_repeated_until_it_is_answered(lost, is_stop, monkeypatch):
    monkeypatch.setattr(navigate, "RETRY_S", 0.0)
    node = FakeNode()
    client = NavigateToPoseClient(node, "/navigate_to_pose", "map", lambda status: None)
    client.send(goal(1))
    ((request, reply),) = node.calls["send_goal"]
    if lost == "the answer to the goal":
        reply.done = True
    else:
        reply.answer = ACCEPTED
    node.has_server = lost != "the answer to the goal"
    client.update()
    node.has_server = lost == "the cancellation"
    if is_stop:
        client.cancel_all()
    else:
        client.cancel()
    node.has_server = True
    for _, reply in node.calls["cancel_goal"]:
        reply.done = True  # and no answer came
    before = len(node.cancelled)
    client.update()
    wanted = {request[4:20], bytes(16)} if is_stop else {request[4:20]}
    assert set(node.cancelled[before:]) == wanted
    for _, reply in node.calls["cancel_goal"]:
        reply.answer = REJECTED
    client.update()
    before = len(node.cancelled)
    client.update()
    assert len(node.cancelled) == before


def test_a_cancellation_ends_with_the_goal_and_a_new_goal_outlives_a_stop(monkeypatch):
    monkeypatch.setattr(navigate, "RETRY_S", 0.0)
    node = FakeNode()
    client = NavigateToPoseClient(node, "/navigate_to_pose", "map", lambda status: None)
    client.send(goal(1))
    ((request, reply),) = node.calls["send_goal"]
    reply.answer = ACCEPTED
    client.update()
    client.cancel_all()
    ended = struct.pack("<4sI16sIIb", b"\0\1\0\0", 1, request[4:20], 0, 0, CANCELED)
    node.statuses.append(("", SimpleNamespace(to_bytes=lambda: ended)))
    client.update()
    client.send(goal(2))
    before = len(node.cancelled)
    client.update()
    assert node.cancelled[before:] == []


def test_closing_takes_the_goal_back(make, nav2):
    make().tick(driving(1))
    goal_id = first_goal(nav2)
    make.made.pop().close()
    assert eventually(lambda: nav2.cancelled) == [goal_id]


def test_recoveries_are_reported(make, nav2, answers):
    make().tick(driving(1))
    goal_id = first_goal(nav2)
    for recoveries in (0, 1, 1):
        nav2.feed_back(goal_id, recoveries, 4.25)
    nav2.feed_back(bytes(16), 9, 1.0)  # of another's goal
    told = answers(2)[1]
    assert told == GoalStatus(1, "accepted", "1 recoveries, 4.2 m left")
    nav2.end(goal_id, SUCCEEDED)
    assert len(answers(3)) == 3


def test_a_lost_result_is_asked_for_again(make, nav2, answers, monkeypatch):
    monkeypatch.setattr(navigate, "RETRY_S", 0.0)
    make().tick(driving(1))
    goal_id = first_goal(nav2)
    nav2.lose(goal_id)
    eventually(lambda: nav2.asked(goal_id))
    nav2.end(goal_id, SUCCEEDED)
    assert answers(2)[1].state == "reached"


def test_a_goal_status_stands_in_for_a_missing_result(make, nav2, answers, monkeypatch):
    monkeypatch.setattr(navigate, "RESULT_LATE_S", 0.0)
    make().tick(driving(1))
    goal_id = first_goal(nav2)
    nav2.say_status(bytes(16), ABORTED)  # of another's goal
    nav2.say_status(goal_id, 2)  # it drives
    nav2.say_status(goal_id, SUCCEEDED)
    assert [a.state for a in answers(2)] == ["accepted", "reached"]


@pytest.mark.parametrize("dialect", [RMW_ZENOH, BRIDGE])
def test_a_nav2_that_dies_has_failed_the_goal(make, theirs, answers, monkeypatch, dialect):
    monkeypatch.setattr(navigate, "RETRY_S", 0.0)
    monkeypatch.setattr(navigate, "GONE_S", 0.0)
    nav2 = Nav2(theirs, dialect=dialect)
    make(via="rmw_zenoh" if dialect.has_tokens else "bridge").tick(driving(1))
    goal_id = first_goal(nav2)
    nav2.close()
    nav2.lose(goal_id)
    assert answers(2)[1] == GoalStatus(1, "failed", "navigate_to_pose is gone")


def test_an_invalid_answer_is_counted_and_requested_again(
    make, nav2, answers, theirs, caplog, monkeypatch
):
    monkeypatch.setattr(navigate, "RETRY_S", 0.0)
    nav2.junk = 2
    make().tick(driving(1))
    eventually(lambda: len(nav2.goals) == 3)
    assert answers(1) == [GoalStatus(1, "accepted")]
    assert caplog.text.count("navigate_to_pose: message ignored: not little") == 1
    goal_id = first_goal(nav2)
    for topic in ("status", "feedback"):
        for _ in range(20):
            theirs.put(names.any_key(0, f"{ACTION}/{topic}").replace("*", "x"), b"junk")
    nav2.end(goal_id, SUCCEEDED)
    assert answers(2)[1].state == "reached"


def test_a_goal_on_a_topic_is_sent_once(make, theirs):
    sink = make(goals="topic", map_frame="odom")
    sink.tick(driving(7, x_m=4.0))
    node = Ros2Node(theirs, 0, "planner")
    planner = node.subscription("/goal_pose", ("geometry_msgs/msg/PoseStamped",), 8)
    ((type_name, payload),) = eventually(planner.take)
    message = from_ros(payload.to_bytes(), type_name)
    assert (message.header.frame_id, message.pose.position.x) == ("odom", 4.0)
    assert planner.take() == []
    node.close()


def test_map_and_drawings(make, theirs):
    sink = make(map_frame="world")
    sink.tick(result(10**9, pose=SE2(1.0, 2.0, 0.0), frontiers=lambda: np.ones((2, 2), np.float32)))
    node = Ros2Node(theirs, 0, "rviz")
    late = node.subscription("/edge/occupancy", ("nav_msgs/msg/OccupancyGrid",), 8, latched=True)
    ((type_name, payload),) = eventually(late.take)
    grid = from_ros(payload.to_bytes(), type_name)
    assert (grid.header.frame_id, grid.data.tolist()) == ("world", [-1, 0, 100, 0])
    path = node.subscription("/edge/path", ("nav_msgs/msg/Path",), 8)
    drawn = node.subscription("/edge/markers", ("visualization_msgs/msg/MarkerArray",), 8)
    ticks = iter(range(2, 10**6))

    def heard(subscription):
        sink.tick(result(next(ticks) * 10**9, pose=SE2(1.0, 2.0, 0.0),
                         frontiers=lambda: np.ones((2, 2), np.float32)))  # fmt: skip
        return subscription.take()

    type_name, payload = eventually(lambda: heard(path))[0]
    (at,) = from_ros(payload.to_bytes(), type_name).poses
    assert (at.pose.position.x, at.header.frame_id) == (1.0, "world")
    type_name, payload = eventually(lambda: heard(drawn))[0]
    _, frontiers = from_ros(payload.to_bytes(), type_name).markers
    assert len(frontiers.points) == 2
    node.close()


def test_subscribers_get_boxes_and_objects(make, theirs):
    sink = make(map_frame="world", detections_frame="camera_optical")
    node = Ros2Node(theirs, 0, "tracker")
    boxes = node.subscription("/edge/detections", ("vision_msgs/msg/Detection2DArray",), 8)
    objects = node.subscription("/edge/objects", ("vision_msgs/msg/Detection3DArray",), 8)
    seen = Observation(seq=0, stamp_ns=77, T_map_base=np.eye(4))
    two, one = np.array([[0, 0, 20, 10], [5, 5, 9, 9]], np.float32), np.ones(2, np.float32)
    found = Detections(seen, two, one, np.array([1, 0], np.int32), ("chair", "bed"))
    behind = Observation(seq=1, stamp_ns=78, T_map_base=np.eye(4), camera_index=1)
    of_second_camera = Detections(behind, two, one, np.array([0, 0], np.int32), ("chair",))
    points = np.array([[1, 2, 0], [2, 2, 1]], np.float32)
    of = partial(Instance, points_m=points, score=0.5, hits=3, first_seen_ns=0, last_seen_ns=0)
    bed, rejected = of(4, "bed", points[0]), of(5, "bed", points[0], state="rejected")
    mug = KnownObject(9, "mug", (3.0, 3.0, 1.0), 0.75, 2, 1.0)
    ticks = iter(range(1, 10**6))

    def heard(subscription):
        for detections in (found, of_second_camera):
            sink.tick(result(next(ticks) * 10**9, detections=detections,
                             instances=lambda: [bed, rejected], objects=lambda: [mug]))  # fmt: skip
        return subscription.take()

    type_name, payload = eventually(lambda: heard(boxes))[0]
    message = from_ros(payload.to_bytes(), type_name)
    assert (message.header.frame_id, message.header.stamp.nanosec) == ("camera_optical", 77)
    assert [box.results[0].hypothesis.class_id for box in message.detections] == ["bed", "chair"]
    type_name, payload = eventually(lambda: heard(objects))[0]
    message = from_ros(payload.to_bytes(), type_name)
    told = [(o.id, o.results[0].hypothesis.class_id, o.bbox.size.x) for o in message.detections]
    assert (message.header.frame_id, told) == ("world", [("4", "bed", 1.0), ("9", "mug", 0.0)])
    node.close()


SQUARE = np.array([(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)])


@pytest.mark.parametrize("via", ["rmw_zenoh", "bridge"])
def test_the_zone_mask_for_nav2_opens_around_the_robot(make, theirs, via):
    sink = make(via=via, keepout_filter=True, map_frame="world")
    node = Ros2Node(theirs, 0, "costmap", dialect_of(via, "edge"))
    kind = "nav2_msgs/msg/CostmapFilterInfo"
    info = node.subscription("/edge/keepout_info", (kind,), 8, latched=True)
    ((type_name, payload),) = eventually(info.take)
    said = from_ros(payload.to_bytes(), type_name)
    assert (said.type, said.base, said.multiplier) == (0, 0.0, 1.0)
    assert (said.filter_mask_topic, said.header.frame_id) == ("/edge/keepout_mask", "world")
    kind = "nav_msgs/msg/OccupancyGrid"
    mask = node.subscription("/edge/keepout_mask", (kind,), 8, latched=True)

    def after(now_s: int, zones: ZonePolygons, x_m: float) -> tuple[set[int], int]:
        """Return the values and the number of cells that a tick publishes."""
        sink.tick(result(now_s * 10**9, zones=zones, pose=SE2(x_m, 1.5, 0.0)))
        type_name, payload = eventually(mask.take)[-1]
        grid = from_ros(payload.to_bytes(), type_name)
        assert grid.header.frame_id == "world"
        assert len(grid.data) == grid.info.width * grid.info.height
        return set(grid.data.tolist()), len(grid.data)

    zones = ZonePolygons((SQUARE,))
    assert after(1, ZonePolygons(), 0.0) == ({-1}, 1)
    values, size = after(2, zones, 0.0)
    assert values == {-1, 100}
    assert after(4, zones, 1.5) == ({-1}, size)
    assert after(6, zones, 0.0) == (values, size)
    sink.tick(result(8 * 10**9, zones=zones, pose=SE2(0.0, 0.0, 0.0)))  # nothing new
    assert after(9, ZonePolygons(), 0.0) == ({-1}, 1)
    node.close()


def test_a_late_subscriber_gets_the_trajectory(make, theirs):
    sink = make(map_frame="world")
    for now_ns in (10**9, 2 * 10**9):
        sink.tick(result(now_ns, task=driven_task))
    node = Ros2Node(theirs, 0, "rviz")
    late = node.subscription("/edge/task_path", ("nav_msgs/msg/Path",), 8, latched=True)
    ((type_name, payload),) = eventually(late.take)
    path, poses = from_ros(payload.to_bytes(), type_name), written()[1].poses
    assert (path.header.frame_id, path.header.stamp.sec) == ("world", 1)
    assert [at.pose.position.y for at in path.poses] == poses[:, 1].tolist()
    sink.tick(result(3 * 10**9))
    ((type_name, payload),) = eventually(late.take)
    assert len(from_ros(payload.to_bytes(), type_name).poses) == 0
    node.close()


@pytest.mark.parametrize(("n", "kept"), [(0, 0), (3, 3), (4, 4), (11, 4)])
def test_the_path_keeps_only_its_newest_points(n, kept):
    way = PathRing(4, 0.1)
    for i in range(n):
        way.add(SE2(float(i), 0.0, math.pi))
        way.add(SE2(i + 0.05, 0.0, 0.0))  # too near
    assert way.poses()[:, 0].tolist() == [float(i) for i in range(n)][-kept:] * (kept > 0)
