"""Sections for the bus, the source, the loop, the web server and the sinks."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, field_validator, model_validator

from edge.config.section import FilePath, Positive, Section
from edge.host.ports import is_loopback
from edge.text import one_line, redact

Key = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$")]
KEY_IN_ENDPOINT = "private_key_base64"
"""Not allowed in an endpoint: Zenoh logs endpoints and shows them to all connected peers."""
TopicName = Literal[
    "camera/rgb", "camera/depth", "camera/info", "camera2/rgb", "camera2/depth", "camera2/info",
    "lidar/points", "lidar/scan", "odom",
    "sim/ground_truth", "sim/segmentation", "sim/segmentation2", "sim/labels",
    "goal", "map", "status", "latency", "mission", "trajectory", "tick", "cmd_vel",
    "goal_status", "mission/request", "models/request", "site/request", "memory/request",
    "stop/request", "release/request", "agent/request", "confirm/request",
]  # fmt: skip


class ZenohConfig(Section):
    """The Zenoh connection between the service, the robot's sensors, its controller and `edge`.

    Attributes:
        endpoint: the service listens here; simulator, controller and commands connect here.
        prefix: first part of the key of every topic and request.
        topics: other keys for topics, below the prefix: `{camera/rgb: front/image_raw}`.
        mode: `peer`: the service listens at `endpoint`. `client`: it connects to the Zenoh router
            at `endpoint`, as do all others.
        shared_memory: send large messages through shared memory. Off by default: Zenoh does not
            free the memory of senders that are gone (zenoh#2787).
        file: configuration file of Zenoh (JSON5) for the service: TLS, users, access control and
            all other settings of Zenoh. The keys of this section are applied on top of it.
        client_file: the same for simulator, controller and commands; null: the same file.
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
        """The endpoint for messages, without a configuration after it, which may hold secrets."""
        return redact(self.endpoint)

    @field_validator("endpoint")
    @classmethod
    def _check_endpoint(cls, endpoint: str) -> str:
        if KEY_IN_ENDPOINT in endpoint:
            raise ValueError(
                f"holds a private key ({KEY_IN_ENDPOINT}), which is not allowed here: put the key "
                "into Zenoh's own configuration file, and the path of that file into zenoh.file"
            )
        return endpoint

    @field_validator("topics")
    @classmethod
    def _check_keys_differ(cls, topics: dict[str, str]) -> dict[str, str]:
        taken: dict[str, str] = {}
        for name in get_args(TopicName):
            key = topics.get(name, name)
            if key in taken:
                raise ValueError(
                    f"{key!r} is the key of both {taken[key]} and {name}: give each topic its own"
                )
            taken[key] = name
        return topics

    def key(self, name: TopicName) -> str:
        """Return the Zenoh key of the topic or request `name`."""
        return f"{self.prefix}/{self.topics.get(name, name)}"


class SourceConfig(Section):
    """The source of observations, and limits for its messages.

    Messages outside the limits are dropped and counted.

    Attributes:
        kind: short name of a source (`edge/sources/__init__.py`), or your own `module:Class`.
        options: arguments of the class.
        max_message_mb: largest message, in MB.
        wait_s: time that a frame waits for its pose, its transforms and frames of the other
            sensors. It waits only for inputs that usually come late. After that, older poses and
            transforms are used; this is counted and reported.
        max_pose_gap_s: a pose is interpolated only between two poses at most this far apart. It is
            extrapolated only from a pose at most this old.
        max_pose_jump_m: the pose may move this far at once, in addition to what the robot can drive
            in the time. A larger jump counts as a new map frame: map and objects are forgotten.
        max_cloud_points: most points of a LiDAR cloud.
        pool_slots: buffers for observations. Loop, detector and recorders share them.
        odometry_ring: number of poses that are kept.
        depth_unit_m: metres of one step of a depth image. null: 0.001 for 16-bit images, 1 for
            32-bit images. Set 0.0002 for steps of 1/5000 m, 0.001 for millimetres as 32FC1.
        distortion: lens distortion of camera_info (`plumb_bob`, `rational_polynomial`,
            `equidistant`). `rectify`: rectify images, and depth registered to them, unless the
            topic's name has the word `rect`. `ignore`: treat all images as rectified. `refuse`:
            drop distorted images.
        scan_inf: LaserScan beams of +inf, or of `range_max` or more (REP 117). `free`: mark the
            cells up to `range_max` as free. `ignore`: treat the beam as no measurement, for drivers
            that write +inf for glass or black surfaces.
        localised: true if poses come from a localization in a saved map, such as AMCL. The saved
            map of `mission.checkpoint` is then valid after any restart. false: it is valid only if
            odometry went on.
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


class LoopConfig(Section):
    """The control loop.

    Attributes:
        hz: ticks per second. A tick uses the newest observation and drops older ones.
        blind_s: the robot stops after this time without a usable observation, or after three frame
            periods if these are longer (docs/robot.md, "When the data is wrong").
        priority: real-time priority of the loop's thread (SCHED_FIFO, 1 to 99); 0: a normal thread.
        lockstep: one tick for each observation, on the clock of its stamps; the detector runs
            inside the tick. No input is dropped for being late, so a run replays bit for bit. For
            simulation and replay, not for a robot.
    """

    hz: Positive = 30.0
    blind_s: Positive = 0.8
    priority: Annotated[int, Field(ge=0, le=99)] = 0
    lockstep: bool = False


class ReportConfig(Section):
    """Publishing rates of the sink `zenoh`.

    Attributes:
        status_hz: rate of the status.
        map_hz: rate of the map.
    """

    status_hz: Positive = 1.0
    map_hz: Positive = 2.0


class HttpConfig(Section):
    """Web pages of the service, such as `/readyz` and `/metrics` (docs/service.md).

    Attributes:
        host: address to listen on.
        port: TCP port; null: no web pages.
        token_file: file with the token that a reader must send. Required if other machines can
            reach `host`.
    """

    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    token_file: FilePath | None = None

    @model_validator(mode="after")
    def _check_token(self) -> HttpConfig:
        if self.port is not None and self.token_file is None and not is_loopback(self.host):
            raise ValueError(
                f"other machines can reach host {one_line(self.host)}: set token_file "
                "(docs/service.md), or host to 127.0.0.1"
            )
        return self


class SinkConfig(Section):
    """A receiver of results. A sink without options may be written as its name alone.

    Attributes:
        kind: short name of a sink (`edge/sinks/__init__.py`), or your own `module:Class`.
        options: arguments of the class.
    """

    kind: str
    options: dict[str, Any] = Field(default_factory=dict)


Sinks = tuple[
    Annotated[
        SinkConfig,
        BeforeValidator(lambda given: {"kind": given} if isinstance(given, str) else given),
    ],
    ...,
]
