"""The sensor loop: where observations come from, when it ticks, what it tells."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, field_validator, model_validator

from edge.config.section import Positive, Section
from edge.host.ports import is_loopback
from edge.text import one_line, without_secrets

Key = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$")]
KEY_IN_ENDPOINT = "private_key_base64"
"""No endpoint may have it: Zenoh logs endpoints, and shows them to whoever is connected."""
FilePath = Annotated[str, Field(min_length=1)]
TopicName = Literal[
    "camera/rgb", "camera/depth", "camera/info", "lidar/points", "lidar/scan", "odom",
    "sim/ground_truth", "sim/segmentation", "sim/labels",
    "goal", "map", "status", "latency", "mission", "trajectory", "tick", "cmd_vel",
    "goal_status", "mission/request", "models/request", "site/request", "memory/request",
]  # fmt: skip


class Zenoh(Section):
    """The service listens; simulator and controller connect to the same endpoint.

    `topics` gives topics other keys below the prefix: `{camera/rgb: front/image_raw}`.

    `file` is a configuration file of Zenoh's own (JSON5): TLS, users, access control and whatever
    else Zenoh knows, for the service; `client_file` the one of all that connects to it, by default
    the same. `edge.bus.zenoh_file` says how the settings here are laid over it.

    `shared_memory` is off since Zenoh keeps that of every sender that has gone (zenoh#2787).
    """

    endpoint: str = "tcp/127.0.0.1:7447"
    prefix: Key = "edge"
    topics: dict[TopicName, Key] = Field(default_factory=dict)
    mode: Literal["peer", "client"] = "peer"
    shared_memory: bool = False
    file: FilePath | None = None
    client_file: FilePath | None = None

    @property
    def address(self) -> str:
        """The endpoint as it may be shown: without the configuration that may follow it."""
        return without_secrets(self.endpoint)

    @field_validator("endpoint")
    @classmethod
    def _holds_no_key(cls, endpoint: str) -> str:
        if KEY_IN_ENDPOINT in endpoint:
            raise ValueError(f"{KEY_IN_ENDPOINT} belongs in a file that zenoh.file names")
        return endpoint

    @field_validator("topics")
    @classmethod
    def _are_apart(cls, topics: dict[str, str]) -> dict[str, str]:
        taken: dict[str, str] = {}
        for name in get_args(TopicName):
            key = topics.get(name, name)
            if key in taken:
                raise ValueError(f"{key!r} is the key of both {taken[key]} and {name}")
            taken[key] = name
        return topics

    def key(self, name: TopicName) -> str:
        """The Zenoh key of a topic, or of a request, that this project calls `name`."""
        return f"{self.prefix}/{self.topics.get(name, name)}"


class Source(Section):
    """Where observations come from, and limits on what is let in.

    `kind` is a short name (`edge/sources/__init__.py`), or `module:Class` of one's own; `options`
    are given to the class. Everything outside the limits is dropped and counted.

    `wait_s`: how long a frame waits for its pose, its transforms and the other sensors' frames of
    its stamp. It waits only for those that come late. Then poses and transforms that are older
    serve, which is counted and reported. `max_pose_gap_s`: how far apart two poses may be between
    which a frame's is interpolated, and how old one may be from which it is extrapolated.

    `depth_unit_m`: metres of one step of a depth image; by default 0.001 in 16-bit images and 1 in
    32-bit ones. Depth in steps of 1/5000 m has 0.0002, millimetres as 32FC1 have 0.001.

    `distortion`: of a lens, as camera_info has it (`plumb_bob`, `rational_polynomial`,
    `equidistant`). `rectify` rectifies images, and depth registered to them, unless the topic's
    name has the word `rect`: these are rectified already. `ignore` takes all images as rectified;
    `refuse` drops them.

    `scan_inf`: a beam of a LaserScan that reads +inf, or range_max or more, met nothing within
    range_max (REP 117). `free` maps that; `ignore` takes such beams for no measurement, for drivers
    that write +inf for glass or black things.

    `localised`: poses are those of a localisation in a map that lasts, as AMCL's in tf. What
    `mission.checkpoint` keeps of places is then good wherever the robot is after a restart, and
    after one of the computer, too; else only where odometry went on.
    """

    kind: str = "zenoh"
    options: dict[str, Any] = Field(default_factory=dict)
    max_message_mb: Positive = 64.0
    wait_s: Annotated[float, Field(ge=0, le=10)] = 0.5
    max_pose_gap_s: Positive = 0.5
    max_pose_jump_m: Positive = 1.0
    max_cloud_points: Annotated[int, Field(ge=16)] = 131072
    pool_slots: Annotated[int, Field(ge=3, le=32)] = 6
    odometry_ring: Annotated[int, Field(ge=64)] = 256
    depth_unit_m: Positive | None = None
    distortion: Literal["rectify", "ignore", "refuse"] = "rectify"
    scan_inf: Literal["free", "ignore"] = "free"
    localised: bool = False


class Loop(Section):
    """`priority` is the loop's among real-time threads (SCHED_FIFO; 0 = an ordinary thread).

    `blind_s`: after so long without an observation that shows the surroundings, or three frames if
    these come less often, the robot stands (docs/robot.md, "When the data is wrong").

    `lockstep` waits for nothing in real time: every observation is one tick and the
    detector runs inside it, so a run replays the same."""

    hz: Positive = 30.0
    blind_s: Positive = 0.8
    priority: Annotated[int, Field(ge=0, le=99)] = 0
    lockstep: bool = False


class Report(Section):
    """`status_hz` and `map_hz`: how often the sink `zenoh` publishes these two."""

    status_hz: Positive = 1.0
    map_hz: Positive = 2.0


class Http(Section):
    """Pages about the service, as `/readyz` and `/metrics` (docs/service.md), on `port`; or none.

    `token_file` holds what whoever reads them must know. Where others than this machine can reach
    `host`, there must be one."""

    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    token_file: FilePath | None = None

    @model_validator(mode="after")
    def _asks_who_is_there(self) -> Http:
        if self.port is not None and self.token_file is None and not is_loopback(self.host):
            raise ValueError(
                f"others can reach host {one_line(self.host)}: set token_file (docs/service.md), "
                "or host to 127.0.0.1"
            )
        return self


class Sink(Section):
    """Where results go: a short name (`edge/sinks/__init__.py`), or `module:Class` of one's own.

    `options` are given to the class; a name alone needs none."""

    kind: str
    options: dict[str, Any] = Field(default_factory=dict)


Sinks = tuple[
    Annotated[
        Sink, BeforeValidator(lambda given: {"kind": given} if isinstance(given, str) else given)
    ],
    ...,
]
