"""The entire configuration, and the functions that read it."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping as Map
from types import MappingProxyType
from typing import Any, Literal

from pydantic import Field, PrivateAttr, ValidationError, ValidationInfo, field_validator

from edge.config.environment import KeyOrigins, apply_overrides, warn_of_unknown_variables
from edge.config.explain import explain_all
from edge.config.loop import (
    HttpConfig,
    LoopConfig,
    ReportConfig,
    SinkConfig,
    Sinks,
    SourceConfig,
    ZenohConfig,
)
from edge.config.mapping import MAX_RADIUS_CELLS, MappingConfig
from edge.config.mcp import McpConfig
from edge.config.mission import MissionConfig
from edge.config.perception import PerceptionConfig
from edge.config.policy import UNKNOWN_RADIUS_M, Policy, PolicyAdaptive, PolicyHvl, PolicyPlugin
from edge.config.robot import Camera, MotionConfig, RobotConfig, SensorsConfig
from edge.config.ros2 import Ros2Config
from edge.config.section import Section
from edge.config.sim import SimConfig
from edge.config.tasks import TasksConfig, TrajectoryLimits
from edge.config.yaml_text import read_yaml
from edge.errors import ConfigError
from edge.host import resources

CLEARANCE_M = 0.1
"""Default clearance of a trajectory from obstacles, in addition to the robot's radius."""
HEADROOM_M, HEADROOM_SHARE = 0.2, 0.25
"""The robot passes under obstacles that are higher than itself by `HEADROOM_M`, or by this share of
its height if that is less."""

ValueSource = Literal["similarity", "choice"]
# Policy → the scorer whose values it uses.
_SCORER_OF_POLICY: dict[str, ValueSource] = {"vlfm": "similarity", "directional": "choice"}
# Scorer → advice for a configuration that lacks it.
_SCORER_ADVICE = {
    "similarity": "perception.similarity to a card, such as cooccurrence-similarity",
    "choice": "perception.choice.kind to openai, text, onnx or cooccurrence",
}


class Config(Section):
    """An entire configuration.

    Attributes:
        path: path of the file. Set by `edge`, not in the file.
        robot: size and limits of the robot.
        sensors: the robot's sensors.
        zenoh: connection of all programs.
        ros2: topics and frames of the robot's ROS 2.
        source: source of observations.
        loop: the control loop.
        mapping: occupancy map.
        perception: detection and tracking of objects.
        policy: selection of the next goal.
        mission: what the robot shall do.
        tasks: trajectories from instructions.
        motion: reference controller.
        sim: simulator.
        report: publishing rates.
        http: web pages.
        mcp: rights of agents; null: agents have none.
        sinks: receivers of results.
    """

    path: str = "<defaults>"
    robot: RobotConfig = RobotConfig()
    sensors: SensorsConfig = SensorsConfig()
    zenoh: ZenohConfig = ZenohConfig()
    ros2: Ros2Config = Ros2Config()
    source: SourceConfig = SourceConfig()
    loop: LoopConfig = LoopConfig()
    mapping: MappingConfig = Field(default=MappingConfig(), validate_default=True)
    perception: PerceptionConfig
    policy: Policy = PolicyHvl()
    mission: MissionConfig = MissionConfig()
    tasks: TasksConfig = Field(default=TasksConfig(), validate_default=True)
    motion: MotionConfig = MotionConfig()
    sim: SimConfig = SimConfig()
    report: ReportConfig = ReportConfig()
    http: HttpConfig = HttpConfig()
    mcp: McpConfig | None = None
    sinks: Sinks = (SinkConfig(kind="zenoh"),)
    _origins: KeyOrigins = PrivateAttr(default_factory=KeyOrigins)

    @field_validator("mapping", "tasks", mode="before")
    @classmethod
    def _default_to_robot_size(cls, section: Any, info: ValidationInfo) -> Any:
        """Set defaults that depend on the robot's size.

        These are `mapping.inflation_m`, `mapping.obstacle_max_m` and
        `tasks.trajectory.clearance_m`. The section `robot` is validated before both sections, so
        its values are numbers here.
        """
        robot = info.data.get("robot")
        if robot is None:  # it is wrong itself, which has its own message
            return section
        if info.field_name == "mapping":
            inflation_m = max(MappingConfig().inflation_m, robot.radius_m)
            section = _with_default(section, ("inflation_m",), inflation_m)
            headroom_m = min(HEADROOM_M, HEADROOM_SHARE * robot.height_m)
            obstacle_max_m = round(robot.height_m + headroom_m, 3)
            return _with_default(section, ("obstacle_max_m",), obstacle_max_m)
        clearance_m = max(TrajectoryLimits().clearance_m, round(robot.radius_m + CLEARANCE_M, 3))
        return _with_default(section, ("trajectory", "clearance_m"), clearance_m)

    def origin(self, *keys: str) -> str:
        """Return what set these keys, for errors: the file, a variable, an option, or several."""
        return self._origins.describe(self.path, *(tuple(key.split(".")) for key in keys))

    def locate(self, key: str, *others: str) -> str:
        """Return the start of an error about a key: `FILE: KEY` or `environment VARIABLE: KEY`."""
        return f"{self.origin(key, *others)}: {key}"

    @property
    def robot_name(self) -> str:
        """The robot's name for people."""
        return self.robot.name or self.zenoh.prefix.rpartition("/")[2]

    @property
    def observed_hz(self) -> float:
        """Rate of observations: that of the sensor that makes the map."""
        camera, lidar = self.sensors.camera, self.sensors.lidar
        if self.mapping.input == "cloud" and lidar is not None:
            return lidar.rate_hz
        return camera.rate_hz

    def farthest_depth_m(self, camera: Camera) -> float:
        """Return the depth from which on a camera measures nothing."""
        perception = self.perception
        return max(camera.depth_max_m, self.mapping.range_m, perception.back_projection_max_range_m)

    @property
    def goals_without_feedback(self) -> bool:
        """True if goals go to a ROS 2 topic, so that no controller reports a result."""
        return self.ros2.goals == "topic" and any(sink.kind == "ros2" for sink in self.sinks)

    @property
    def value_source(self) -> ValueSource | None:
        """The scorer that writes the value maps: the one that the policy uses; None: no scorer.

        A value map has a score for each cell and target: how promising the cell is.
        A plugin gets the maps of the choice scorer if there is one, else those of similarity.
        """
        if isinstance(self.policy, PolicyPlugin):
            configured = self._configured_scorers()
            return configured[0] if configured else None
        if isinstance(self.policy, PolicyAdaptive):
            return None if self.policy.by == "prior" else self.policy.by
        return _SCORER_OF_POLICY.get(self.policy.kind)

    def _check_cells(self) -> None:
        """Raise ConfigError if the cells are too small for the policy `hvl`."""
        cell_m = self.mapping.resolution_m
        if isinstance(self.policy, PolicyHvl) and MAX_RADIUS_CELLS * cell_m < UNKNOWN_RADIUS_M:
            least_m = math.ceil(1e4 * UNKNOWN_RADIUS_M / MAX_RADIUS_CELLS) / 1e4
            raise ConfigError(
                f"{self.locate('mapping.resolution_m', 'policy.kind')}: {cell_m:g}: too fine for "
                f"policy.kind hvl, which counts unknown cells within {UNKNOWN_RADIUS_M:g} m: set "
                f"mapping.resolution_m to at least {least_m:g}, or another policy.kind"
            )

    def _configured_scorers(self) -> list[ValueSource]:
        """Return the scorers that the configuration has, the preferred one first."""
        similar: list[ValueSource] = [] if self.perception.similarity is None else ["similarity"]
        return similar if self.perception.choice.kind == "none" else ["choice", *similar]

    def check_site(self) -> None:
        """Refuse a file of places if the map frame changes with each start.

        Raises:
            ConfigError: one line: the key, and what to set.
        """
        if self.mission.site is not None and not self.source.localised:
            raise ConfigError(
                f"{self.locate('mission.site', 'source.localised')}: a file of places needs a map "
                "frame that is the same after each start: set source.localised to true if it is, "
                "or remove mission.site"
            )

    def check_policy(self) -> None:
        """Refuse a policy that lacks a scorer or needs larger cells; refuse values without a prior.

        Raises:
            ConfigError: one line: the key, and what to set.
        """
        self._check_cells()
        source, kind = self.value_source, self.policy.kind
        if source is not None and source not in self._configured_scorers():
            raise ConfigError(
                f"{self.locate('policy.kind', f'perception.{source}')}: {kind} needs the {source} "
                f"scorer, and none is configured: set {_SCORER_ADVICE[source]}"
            )
        by_prior = {
            "policy.by": getattr(self.policy, "by", None),
            "perception.choice.kind": self.perception.choice.kind,
        }
        for key, value in by_prior.items():
            if value in ("prior", "cooccurrence") and self.perception.prior == "none":
                raise ConfigError(
                    f"{self.locate(key, 'perception.prior')}: {value} needs a prior, and none is "
                    "configured: set perception.prior to cooccurrence, rooms or both"
                )


def load(
    name_or_path: str,
    environ: Map[str, str] | None = None,
    options: Map[str, str] = MappingProxyType({}),
) -> Config:
    """Read a configuration, apply the overrides of the environment, and validate it.

    Args:
        name_or_path: a YAML file, or the name of a built-in configuration (`demo`).
        environ: environment with the overrides; None: the environment of this process.
        options: command line options that set a variable of `environ`, by variable.

    Raises:
        ConfigError: one line for each fault: file, key, what is wrong, what to set.

    Example:
        >>> load("demo", {"EDGE__MISSION__TARGET": "sofa"}).mission.target
        'sofa'
    """
    path = resources.find_config(name_or_path)
    data = read_yaml(path)
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: expected sections (robot:, sensors:, …) at the top level")
    environ = os.environ if environ is None else environ
    origins = apply_overrides(data, environ, options)
    warn_of_unknown_variables(environ, Config)
    return parse(data, str(path), origins)


def parse(
    data: dict[str, Any], path: str = "<defaults>", origins: KeyOrigins | None = None
) -> Config:
    """Validate the content of a configuration file; see `load`.

    Example:
        >>> parse({"perception": {"detector": {"kind": "sim"}}}).robot.radius_m
        0.2
    """
    origins = KeyOrigins() if origins is None else origins
    try:
        # An empty section, so that the error names the missing key, not the missing section.
        config = Config.model_validate({"perception": {}, **data, "path": path})
    except ValidationError as error:
        raise ConfigError(explain_all(error, path, Config, origins.describe)) from None
    config._origins = origins
    config.check_policy()
    config.check_site()
    return config


def _with_default(section: Any, path: tuple[str, ...], value: float) -> Any:
    """Return the section with a value at `path` if none is set there."""
    if isinstance(section, Section):
        section = {name: getattr(section, name) for name in section.model_fields_set}
    if not isinstance(section, dict):
        return section
    key, *rest = path
    if rest:
        return {**section, key: _with_default(section.get(key, {}), tuple(rest), value)}
    return {key: value, **section}
