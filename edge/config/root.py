"""The whole configuration, and how it is read."""

from __future__ import annotations

import os
from collections.abc import Mapping as Map
from types import MappingProxyType
from typing import Any, Literal

from pydantic import Field, PrivateAttr, ValidationError, ValidationInfo, field_validator

from edge.config.environment import Origins, override, warn_of_unread
from edge.config.explain import explain_all
from edge.config.loop import Http, Loop, Report, Sink, Sinks, Source, Zenoh
from edge.config.mapping import Mapping
from edge.config.mission import Mission
from edge.config.perception import Perception
from edge.config.policy import Policy, PolicyAdaptive, PolicyHvl, PolicyOwn
from edge.config.removed import without_removed
from edge.config.robot import Motion, Robot, Sensors
from edge.config.ros2 import Ros2
from edge.config.section import Section
from edge.config.sim import Sim
from edge.config.tasks import Tasks, TrajectoryLimits
from edge.config.yaml_text import read_yaml
from edge.errors import ConfigError
from edge.host import resources

CLEARANCE_M = 0.1
"""A trajectory stays so much farther from obstacles than the robot's radius."""
HEADROOM_M, HEADROOM_SHARE = 0.2, 0.25
"""The robot passes under what is higher than itself by so much, or by this share of its height if
that is less."""

ValueSource = Literal["similarity", "choice"]
_GOES_BY: dict[str, ValueSource] = {"vlfm": "similarity", "directional": "choice"}
_SCORER = {
    "similarity": "perception.similarity to a card, such as cooccurrence-similarity",
    "choice": "perception.choice.kind to openai, text, onnx or cooccurrence",
}


class Config(Section):
    """A whole configuration; `path` is where it came from."""

    path: str = "<defaults>"
    robot: Robot = Robot()
    sensors: Sensors = Sensors()
    zenoh: Zenoh = Zenoh()
    ros2: Ros2 = Ros2()
    source: Source = Source()
    loop: Loop = Loop()
    mapping: Mapping = Field(default=Mapping(), validate_default=True)
    perception: Perception
    policy: Policy = PolicyHvl()
    mission: Mission = Mission()
    tasks: Tasks = Field(default=Tasks(), validate_default=True)
    motion: Motion = Motion()
    sim: Sim = Sim()
    report: Report = Report()
    http: Http = Http()
    sinks: Sinks = (Sink(kind="zenoh"),)
    _origins: Origins = PrivateAttr(default_factory=Origins)

    @field_validator("mapping", "tasks", mode="before")
    @classmethod
    def _fit_the_robot(cls, section: Any, info: ValidationInfo) -> Any:
        """Inflate obstacles by more around a wider robot, and keep its trajectories farther from
        them, where `mapping.inflation_m` and `tasks.trajectory.clearance_m` are not set. A higher
        robot has higher obstacles, where `mapping.obstacle_max_m` is not set.

        The robot comes before both sections, so that its radius is already a number here, however
        the file writes it.
        """
        robot = info.data.get("robot")
        if robot is None:  # it is at fault itself
            return section
        if info.field_name == "mapping":
            inflation_m = max(Mapping().inflation_m, robot.radius_m)
            section = _with_default(section, ("inflation_m",), inflation_m)
            headroom_m = min(HEADROOM_M, HEADROOM_SHARE * robot.height_m)
            obstacle_max_m = round(robot.height_m + headroom_m, 3)
            return _with_default(section, ("obstacle_max_m",), obstacle_max_m)
        clearance_m = max(TrajectoryLimits().clearance_m, round(robot.radius_m + CLEARANCE_M, 3))
        return _with_default(section, ("trajectory", "clearance_m"), clearance_m)

    def origin(self, *keys: str) -> str:
        """Return what set keys, for errors: the file, a variable of the environment, or several."""
        return self._origins.of(self.path, *(tuple(key.split(".")) for key in keys))

    def at(self, key: str, *others: str) -> str:
        """Return how an error about a key begins: `FILE: KEY`, or `environment VARIABLE: KEY`.

        Args:
            others: keys that the error is about, too.
        """
        return f"{self.origin(key, *others)}: {key}"

    @property
    def robot_name(self) -> str:
        """What people know the robot by."""
        return self.robot.name or self.zenoh.prefix.rpartition("/")[2]

    @property
    def observed_hz(self) -> float:
        """How often observations come: as what the map is made of."""
        camera, lidar = self.sensors.camera, self.sensors.lidar
        if self.mapping.input == "cloud" and lidar is not None:
            return lidar.rate_hz
        return camera.rate_hz

    @property
    def farthest_depth_m(self) -> float:
        """Depth from here on is no return: neither seen by the camera, nor used."""
        camera, perception = self.sensors.camera, self.perception
        return max(camera.depth_max_m, self.mapping.range_m, perception.lift_max_range_m)

    @property
    def goals_unanswered(self) -> bool:
        """Whether goals go to a ROS 2 topic, which nobody answers."""
        return self.ros2.goals == "topic" and any(sink.kind == "ros2" for sink in self.sinks)

    @property
    def value_source(self) -> ValueSource | None:
        """The scorer that the value maps are written from: the one that the policy goes by.

        A policy of one's own gets those of the choice scorer, where there is one.
        """
        if isinstance(self.policy, PolicyOwn):
            there = self._scorers_there()
            return there[0] if there else None
        if isinstance(self.policy, PolicyAdaptive):
            return None if self.policy.by == "prior" else self.policy.by
        return _GOES_BY.get(self.policy.kind)

    def _scorers_there(self) -> list[ValueSource]:
        similar: list[ValueSource] = [] if self.perception.similarity is None else ["similarity"]
        return similar if self.perception.choice.kind == "none" else ["choice", *similar]

    def check_site(self) -> None:
        """Refuse a file of places in a frame that does not outlive the service.

        Raises:
            ConfigError: one line: the key, and what to set.
        """
        if self.mission.site is not None and not self.source.localised:
            raise ConfigError(
                f"{self.at('mission.site', 'source.localised')}: a file of places needs poses in a "
                "map that lasts: set source.localised to true, or remove mission.site"
            )

    def check_policy(self) -> None:
        """Refuse a policy that would go by what no scorer says, and a scorer without its prior.

        Raises:
            ConfigError: one line: the key, and what to set.
        """
        source, kind = self.value_source, self.policy.kind
        if source is not None and source not in self._scorers_there():
            raise ConfigError(
                f"{self.at('policy.kind', f'perception.{source}')}: {kind} goes by the {source} "
                f"scorer, and none is configured: set {_SCORER[source]}"
            )
        by_prior = {
            "policy.by": getattr(self.policy, "by", None),
            "perception.choice.kind": self.perception.choice.kind,
        }
        for key, value in by_prior.items():
            if value in ("prior", "cooccurrence") and self.perception.prior == "none":
                raise ConfigError(
                    f"{self.at(key, 'perception.prior')}: {value}: there is no prior: set "
                    "perception.prior to cooccurrence, rooms or both"
                )


def load(
    name_or_path: str,
    environ: Map[str, str] | None = None,
    options: Map[str, str] = MappingProxyType({}),
) -> Config:
    """Read a configuration, apply the environment's overrides, validate.

    Args:
        name_or_path: a YAML file, or the name of a ready configuration (`demo`).
        environ: where overrides are looked for; the process's environment by default.
        options: of the command line that set variables of `environ`, by variable.

    Raises:
        ConfigError: with one line per fault: file, key, what is wrong, what would be right.
    """
    path = resources.find_config(name_or_path)
    data = read_yaml(path)
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: expected sections (robot:, sensors:, …) at the top")
    environ = os.environ if environ is None else environ
    origins = override(data, environ, options)
    warn_of_unread(environ, Config)
    return parse(data, str(path), origins)


def parse(data: dict[str, Any], path: str = "<defaults>", origins: Origins | None = None) -> Config:
    """Validate a mapping; see `load`.

    Args:
        origins: what set the keys that the file at `path` did not set.
    """
    origins = Origins() if origins is None else origins
    data = without_removed(data, path, origins)
    try:
        # An empty section, so that its fault is the key that it lacks.
        config = Config.model_validate({"perception": {}, **data, "path": path})
    except ValidationError as error:
        raise ConfigError(explain_all(error, path, Config, origins.of)) from None
    config._origins = origins
    config.check_policy()
    config.check_site()
    return config


def _with_default(section: Any, path: tuple[str, ...], value: float) -> Any:
    """Return the section with a value where none is set there; what is no section as it is."""
    if isinstance(section, Section):
        section = {name: getattr(section, name) for name in section.model_fields_set}
    if not isinstance(section, dict):
        return section
    key, *rest = path
    if rest:
        return {**section, key: _with_default(section.get(key, {}), tuple(rest), value)}
    return {key: value, **section}
