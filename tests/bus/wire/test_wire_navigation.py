"""tf, paths, markers and Nav2's action against `rosbags`, which knows them from ROS's own texts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from ros_messages import (
    DOCK_FAREWELLS,
    FAREWELLS,
    STORE,
    UNDOCK_FAREWELLS,
    from_ros,
    header,
    pose,
    to_ros,
)
from simulated import simulated

from edge.bus.wire import DecodeError, markers, navigation, transforms
from edge.geometry import SE2
from edge.sources.tf import RobotFrames

ID = bytes(range(16))
GOAL = SE2(1.5, -2.0, 0.5)


def ros_id(goal_id: bytes = ID):
    return STORE.types["unique_identifier_msgs/msg/UUID"](np.frombuffer(goal_id, np.uint8))


def transform(parent: str, child: str, x_m: float):
    types = STORE.types
    moved = types["geometry_msgs/msg/Vector3"](x_m, 2.0, 3.0)
    turned = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(0.25), math.cos(0.25))
    return types["geometry_msgs/msg/TransformStamped"](
        header(7, parent), child, types["geometry_msgs/msg/Transform"](moved, turned)
    )


@pytest.mark.parametrize("names", [(), ("a",), ("base_link", "camera_link", "x")])
def test_transforms(names):
    sent = [transform("/odom", name, float(i)) for i, name in enumerate(names)]
    payload = to_ros(STORE.types["tf2_msgs/msg/TFMessage"](sent))
    got, faults = transforms.decode_transforms(payload)
    assert faults == []
    assert [(t.stamp_ns, t.parent, t.child, t.T[0, 3]) for t in got] == [
        (7, "odom", name, float(i)) for i, name in enumerate(names)
    ]
    for t in got:
        np.testing.assert_allclose(t.T[:2, :2], [[math.cos(0.5), -math.sin(0.5)],
                                                 [math.sin(0.5), math.cos(0.5)]])  # fmt: skip


@pytest.mark.parametrize(
    ("field", "fault"), [("x", "NaN or inf"), ("w", "quaternion")], ids=["nan", "zero quaternion"]
)
def test_an_invalid_transform_is_left_out(field, fault):
    bad = transform("base_link", "gripper", math.nan if field == "x" else 1.0)
    if field == "w":
        bad.transform.rotation = STORE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 0.0)
    sent = [transform("base_link", "a", 1.0), bad, transform("base_link", "b", 2.0)]
    payload = to_ros(STORE.types["tf2_msgs/msg/TFMessage"](sent))
    got, faults = transforms.decode_transforms(payload)
    assert [t.child for t in got] == ["a", "b"]
    (said,) = faults
    assert said.startswith("from 'gripper' to 'base_link' (")
    assert fault in said
    frames = RobotFrames(simulated({"ros2": {"mounts": "tf"}}))
    assert frames.take(payload, static=True) == f"1 transforms, the first {said}"
    assert frames.why_unplaced("b") == ""
    with pytest.raises(DecodeError):
        transforms.decode_transforms(payload[:-1])


@pytest.mark.parametrize("frame_id", ["map", "", "odometry", "m"])
@pytest.mark.parametrize("n", [0, 1, 2, 5])
def test_a_path(frame_id, n):
    poses = np.arange(3.0 * n).reshape(n, 3) / 10
    z_m = np.arange(n) / 4
    payload = transforms.encode_path(10**9 + 5, frame_id, poses, z_m)
    path = from_ros(payload, "nav_msgs/msg/Path")
    assert (path.header.frame_id, path.header.stamp.nanosec) == (frame_id, 5)
    got = [
        (p.header.frame_id, p.pose.position.x, p.pose.position.y,
         2 * math.atan2(p.pose.orientation.z, p.pose.orientation.w))
        for p in path.poses
    ]  # fmt: skip
    assert got == [(frame_id, x, y, pytest.approx(yaw)) for x, y, yaw in poses]
    assert [p.pose.position.z for p in path.poses] == z_m.tolist()


def test_markers():
    points = np.arange(9.0).reshape(3, 3)
    sent = [
        markers.Marker("frontiers", 0, markers.SPHERE_LIST, (0.1,) * 3, (1, 0, 0, 1),
                       points_m=points),
        markers.Marker("things", 5, markers.TEXT, (0, 0, 0.2), (1, 1, 1, 0.5), GOAL, 1.0, "bed"),
    ]  # fmt: skip
    payload = markers.encode_markers(9, "map", sent)
    clear, dots, text = from_ros(payload, "visualization_msgs/msg/MarkerArray").markers
    assert to_ros(from_ros(payload, "visualization_msgs/msg/MarkerArray")) == payload
    assert (clear.action, clear.ns) == (3, "")
    assert (dots.action, dots.type, dots.ns, dots.header.frame_id) == (0, 7, "frontiers", "map")
    assert [[p.x, p.y, p.z] for p in dots.points] == points.tolist()
    assert (text.id, text.text, text.pose.position.z, text.scale.z) == (5, "bed", 1.0, 0.2)
    assert (text.color.a, text.lifetime.sec) == (0.5, 0)


def test_empty_markers_delete_all():
    (clear,) = from_ros(
        markers.encode_markers(9, "map", ()), "visualization_msgs/msg/MarkerArray"
    ).markers
    assert clear.action == 3


def test_a_goal_for_the_action():
    name = "nav2_msgs/msg/NavigateToPose_SendGoal_Request"
    payload = navigation.encode_send_goal(ID, 5, GOAL, "odom")
    request = from_ros(payload, name)
    assert bytes(request.goal_id.uuid) == ID
    assert request.goal.pose.header.frame_id == "odom"
    assert (request.goal.pose.pose.position.x, request.goal.behavior_tree) == (1.5, "")
    assert to_ros(request) == payload


@pytest.mark.parametrize("accepted", [False, True])
def test_the_answer_to_a_goal_is_decoded(accepted):
    time = STORE.types["builtin_interfaces/msg/Time"](1, 2)
    answer = STORE.types["nav2_msgs/msg/NavigateToPose_SendGoal_Response"](accepted, time)
    assert navigation.decode_send_goal_answer(to_ros(answer)) is accepted


@pytest.mark.parametrize("distribution", FAREWELLS)
def test_its_result_in_every_distribution(distribution):
    farewell, expected = FAREWELLS[distribution]
    assert navigation.decode_result(farewell(6, 103, "no way")) == expected


@pytest.mark.parametrize("distribution", DOCK_FAREWELLS)
def test_the_result_of_docking(distribution):
    farewell, expected = DOCK_FAREWELLS[distribution]
    assert navigation.decode_result(farewell(6, 902, "no dock"), True, True) == expected


def test_a_goal_of_docking():
    payload = navigation.encode_dock_goal(ID, 5, "bay_1", "odom")
    request = from_ros(payload, "nav2_msgs/msg/DockRobot_SendGoal_Request")
    assert bytes(request.goal_id.uuid) == ID
    goal = request.goal
    assert (goal.use_dock_id, goal.dock_id, goal.dock_type) == (True, "bay_1", "")
    assert (goal.max_staging_time, goal.navigate_to_staging_pose) == (1000.0, True)
    assert goal.dock_pose.header == header(5, "odom")


@pytest.mark.parametrize("distribution", UNDOCK_FAREWELLS)
def test_the_result_of_undocking(distribution):
    farewell, expected = UNDOCK_FAREWELLS[distribution]
    assert navigation.decode_result(farewell(6, 902, "no dock"), True) == expected


def test_a_goal_of_undocking():
    name = "nav2_msgs/msg/UndockRobot_SendGoal_Request"
    request = from_ros(navigation.encode_undock_goal(ID), name)
    assert bytes(request.goal_id.uuid) == ID
    assert (request.goal.dock_type, request.goal.max_undocking_time) == ("", 30.0)


def test_result_and_cancel_requests_carry_the_goal_id():
    name = "nav2_msgs/msg/NavigateToPose_GetResult_Request"
    assert bytes(from_ros(navigation.encode_get_result(ID), name).goal_id.uuid) == ID
    request = from_ros(navigation.encode_cancel(ID), "action_msgs/msg/CancelGoal_Request")
    assert bytes(request.goal_info.goal_id.uuid) == ID


@pytest.mark.parametrize("n", [0, 1, 3])
def test_the_states_of_goals(n):
    types, time = STORE.types, STORE.types["builtin_interfaces/msg/Time"](1, 2)
    goals = [
        types["action_msgs/msg/GoalStatus"](
            types["action_msgs/msg/GoalInfo"](ros_id(bytes([k]) * 16), time), 4 + k
        )
        for k in range(n)
    ]
    payload = to_ros(types["action_msgs/msg/GoalStatusArray"](goals))
    assert navigation.decode_goal_statuses(payload) == [(bytes([k]) * 16, 4 + k) for k in range(n)]


def feedback_payload() -> bytes:
    types = STORE.types
    duration = types["builtin_interfaces/msg/Duration"]
    where = types["geometry_msgs/msg/PoseStamped"](header(5, "map"), pose(GOAL))
    inner = types["nav2_msgs/msg/NavigateToPose_Feedback"](
        where, duration(3, 500_000_000), duration(9, 0), 2, 4.25
    )
    return to_ros(types["nav2_msgs/msg/NavigateToPose_FeedbackMessage"](ros_id(), inner))


def test_feedback():
    got = navigation.decode_feedback(feedback_payload())
    assert (got.goal_id, got.recoveries, got.distance_m) == (ID, 2, 4.25)
