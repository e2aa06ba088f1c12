"""What `edge ros2-adapter` passes between the robot's ROS 2 (DDS) and the service (Zenoh)."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from edge.config.section import Section

RosName = Annotated[str, Field(pattern=r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$")]
RosType = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*/(msg|action)/[A-Z][A-Za-z0-9]*$")]
OurName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$")]


class Passed(Section):
    """A topic of ROS: its name, and where the usual does not do its type and quality of service.

    Best effort hears reliable publishers too; `latched` is ROS's transient local.
    """

    topic: RosName
    type: RosType | None = None
    reliable: bool | None = None
    latched: bool | None = None
    depth: Annotated[int, Field(ge=1, le=1000)] = 5


def _by_name(given: Any) -> Any:
    return {"topic": given} if isinstance(given, str) else given


PassedByName = Annotated[Passed, BeforeValidator(_by_name)]


class Ros2Adapter(Section):
    """Ours to theirs: `sensors` are heard in ROS, `results` are published there.

    `goals` names the action that goals are given to; null: whoever takes `goal` answers on
    `goal_status` by other means. `python` has rclpy and eclipse-zenoh; `setup` is sourced first,
    where ROS 2's setup file was not sourced before `edge` was started.
    """

    python: str = "/usr/bin/python3"
    setup: str | None = None
    node: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")] = "edge_adapter"
    sensors: dict[OurName, PassedByName] = Field(default_factory=dict)
    results: dict[OurName, PassedByName] = Field(default_factory=dict)
    goals: RosName | None = "/navigate_to_pose"
