"""Access rules of `config/secure/ros2-router.json5` in a ROS 2 graph.

They limit the service on another computer, and all other clients.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh
from live_patience import PATIENCE_S, eventually
from secure_files import etc_edge, page_section, refusal

from edge.bus.ros2.node import Ros2Node, Ros2Publisher, Ros2Subscription
from edge.bus.session import zenoh_session
from edge.config import ZenohConfig
from edge.config.yaml_text import parse_yaml
from edge.host.ports import free_port

ODOMETRY, TF = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
BOOL = "std_msgs/msg/Bool"
POSE, MAP = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/OccupancyGrid"
SEND_GOAL = "nav2_msgs/action/NavigateToPose_SendGoal"
ACTION = "/navigate_to_pose/_action/send_goal"
REQUEST = "edge/mission/request"


@pytest.fixture(scope="module")
def etc(tmp_path_factory) -> Path:
    return etc_edge(tmp_path_factory.mktemp("etc-edge"))


@dataclass
class Graph:
    """Router endpoints for the robot's own nodes and for others."""

    etc: Path
    here: int
    outside: int

    @contextmanager
    def robot(self) -> Iterator[zenoh.Session]:
        settings = ZenohConfig(endpoint=f"tcp/127.0.0.1:{self.here}", mode="client")
        with zenoh_session(settings, "listen") as session:
            yield session

    def settings(self, file: str) -> ZenohConfig:
        """Configure a client as the page describes, with its own file."""
        section = page_section("7448", self.etc).replace(
            "robot.local:7448", f"127.0.0.1:{self.outside}"
        )
        known = ZenohConfig(**parse_yaml(section)["zenoh"], shared_memory=False)
        return known.model_copy(update={"file": str(self.etc / file)})

    @contextmanager
    def outsider(self, file: str) -> Iterator[zenoh.Session]:
        with zenoh_session(self.settings(file), "listen") as session:
            yield session


@pytest.fixture
def graph(etc, tmp_path) -> Iterator[Graph]:
    here, outside = free_port(), free_port()
    rules = (etc / "ros2-router.json5").read_text()
    file = tmp_path / "router.json5"
    file.write_text(
        rules.replace("7447", str(here)).replace("0.0.0.0:7448", f"127.0.0.1:{outside}")
    )
    config = zenoh.Config.from_file(str(file))
    # As in rmw_zenohd's own configuration.
    for key, value in {
        "mode": "router", "scouting/multicast/enabled": False, "timestamping/enabled": True,
    }.items():  # fmt: skip
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        yield Graph(etc, here, outside)


@contextmanager
def node(session: zenoh.Session, name: str) -> Iterator[Ros2Node]:
    made = Ros2Node(session, 0, name)
    yield made
    made.close()


def until(nodes: list[Ros2Node], done: Callable[[], bool], otherwise: str) -> None:
    def look() -> bool:
        for each in nodes:
            each.update()
        return done()

    eventually(look, otherwise)


def test_the_service_has_only_the_rights_it_needs(graph):
    with ExitStack() as stack:
        robot = stack.enter_context(node(stack.enter_context(graph.robot()), "robot"))
        service = stack.enter_context(
            node(stack.enter_context(graph.outsider("navigator.json5")), "edge")
        )
        moored = robot.publisher("/tf_static", TF, latched=True)
        moored.put(b"moored")
        button = robot.publisher("/edge/stop", BOOL, latched=True)
        button.put(b"pressed")
        drawn = service.publisher("/edge/occupancy", MAP, latched=True)
        drawn.put(b"map")
        sent: dict[str, Ros2Publisher] = {
            "odom": robot.publisher("/odom", ODOMETRY),
            "private": robot.publisher("/private", ODOMETRY),
            "goal": service.publisher("/goal_pose", POSE),
            "cmd_vel": service.publisher("/cmd_vel", POSE),
            "map of another": service.publisher("/map", MAP),
        }
        heard: dict[str, Ros2Subscription] = {
            "odom": service.subscription("/odom", (ODOMETRY,), 8, latched=False),
            "private": service.subscription("/private", (ODOMETRY,), 8, latched=False),
            "moored": service.subscription("/tf_static", (TF,), 8, latched=True),
            "pressed": service.subscription("/edge/stop", (BOOL,), 8, latched=True),
            "goal": robot.subscription("/goal_pose", (POSE,), 8, latched=False),
            "cmd_vel": robot.subscription("/cmd_vel", (POSE,), 8, latched=False),
            "map of another": robot.subscription("/map", (MAP,), 8, latched=False),
            "drawn": robot.subscription("/edge/occupancy", (MAP,), 8, latched=True),
        }
        counts = dict.fromkeys(heard, 0)

        def exchange() -> bool:
            for publisher in sent.values():
                publisher.put(b"said")
            for name, subscription in heard.items():
                counts[name] += len(subscription.take())
            return min(counts["odom"], counts["goal"]) > 5 and all(
                counts[name] for name in ("moored", "pressed", "drawn")
            )

        until([robot, service], exchange, "what is allowed does not come")
        assert (counts["private"], counts["cmd_vel"], counts["map of another"]) == (0, 0, 0)

        action = service.client(ACTION, SEND_GOAL, PATIENCE_S).key()
        for key in (action, "0/shut_down/std_srvs::srv::dds_::Empty_/x"):
            stack.enter_context(robot.session.declare_queryable(key, _say_yes))
        eventually(lambda: asks(service.session, action), "the action is not answered")
        assert not asks(service.session, "0/shut_down/std_srvs::srv::dds_::Empty_/x")


def _say_yes(query: zenoh.Query) -> None:
    query.reply(query.key_expr, b"yes")


def asks(session: zenoh.Session, key: str) -> bool:
    """Return True if a request is answered."""
    return bool(list(session.get(key, payload=b"{}", timeout=PATIENCE_S)))


def test_the_operator_asks_and_can_send_no_goal(graph):
    with ExitStack() as stack:
        robot = stack.enter_context(node(stack.enter_context(graph.robot()), "robot"))
        service = stack.enter_context(graph.outsider("navigator.json5"))
        operator = stack.enter_context(graph.outsider("client.json5"))
        goals = robot.subscription("/goal_pose", (POSE,), 64, latched=False)
        stack.enter_context(service.declare_queryable(REQUEST, _say_yes))

        def asked() -> bool:
            operator.put("0/goal_pose/geometry_msgs::msg::dds_::PoseStamped_/x", b"spoofed")
            return asks(operator, REQUEST)

        until([robot], asked, "the operator is not answered")
        assert goals.take() == []


def test_a_stranger_is_kept_out(graph):
    stranger = ZenohConfig(endpoint=f"tls/127.0.0.1:{graph.outside}", mode="client")
    assert refusal(stranger, "mission: refused at ")
