"""The whole configuration, and how it is read."""

from __future__ import annotations

import math
import os
from typing import Any, Literal

from pydantic import ValidationError, model_validator

from edge.config.explain import explain
from edge.config.loop import Http, Loop, Report, Sink, Sinks, Source, Zenoh
from edge.config.mapping import Mapping
from edge.config.mission import Mission
from edge.config.perception import Perception
from edge.config.policy import Policy, PolicyAdaptive, PolicyHvl, PolicyOwn
from edge.config.robot import Motion, Robot, Sensors
from edge.config.ros2 import Ros2
from edge.config.section import Section
from edge.config.sim import Sim
from edge.config.tasks import Tasks, TrajectoryLimits
from edge.config.yaml_text import parse_yaml, read_yaml
from edge.errors import ConfigError
from edge.host import resources
from edge.text import without_secrets

MARGIN_M = 0.02
"""Obstacles are inflated by so much more than the robot's radius, unless told otherwise."""
CLEARANCE_M = 0.1
"""A trajectory stays so much farther from obstacles than the robot's radius."""
ENV_PREFIX = "EDGE__"

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
    mapping: Mapping = Mapping()
    perception: Perception
    policy: Policy = PolicyHvl()
    mission: Mission = Mission()
    tasks: Tasks = Tasks()
    motion: Motion = Motion()
    sim: Sim = Sim()
    report: Report = Report()
    http: Http = Http()
    sinks: Sinks = (Sink(kind="zenoh"),)

    @model_validator(mode="before")
    @classmethod
    def _wide_as_the_robot(cls, data: Any) -> Any:
        """Around a wider robot obstacles are inflated by more, and its trajectories keep farther
        from them, where `mapping.inflation_m` and `tasks.trajectory.clearance_m` are not set."""
        robot = data.get("robot") if isinstance(data, dict) else None
        radius_m = robot.get("radius_m") if isinstance(robot, dict) else None
        if not isinstance(radius_m, (int, float)) or not math.isfinite(radius_m):
            return data
        inflation_m = max(Mapping().inflation_m, round(radius_m + MARGIN_M, 3))
        clearance_m = max(TrajectoryLimits().clearance_m, round(radius_m + CLEARANCE_M, 3))
        data = _with_default(data, ("mapping", "inflation_m"), inflation_m)
        return _with_default(data, ("tasks", "trajectory", "clearance_m"), clearance_m)

    @property
    def robot_name(self) -> str:
        """What people know the robot by."""
        return self.robot.name or self.zenoh.prefix.rpartition("/")[2]

    @property
    def observed_hz(self) -> float:
        """How often observations come: as what the map is made of."""
        camera, lidar = self.sensors.camera, self.sensors.lidar
        by_lidar = self.mapping.input == "cloud" and lidar is not None
        return lidar.rate_hz if by_lidar else camera.rate_hz

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

    def check_policy(self) -> None:
        """Refuse a policy that would go by what no scorer says, and a scorer without its prior.

        Raises:
            ConfigError: one line: the key, and what to set.
        """
        source, kind = self.value_source, self.policy.kind
        if source is not None and source not in self._scorers_there():
            raise ConfigError(
                f"{self.path}: policy.kind: {kind} goes by the {source} scorer, and none is "
                f"configured: set {_SCORER[source]}"
            )
        by_prior = {
            "policy.by: prior": getattr(self.policy, "by", None) == "prior",
            "perception.choice.kind: cooccurrence": self.perception.choice.kind == "cooccurrence",
        }
        for key, needed in by_prior.items():
            if needed and self.perception.prior == "none":
                raise ConfigError(
                    f"{self.path}: {key}: there is no prior: set perception.prior to "
                    "cooccurrence, rooms or both"
                )


def load(name_or_path: str, environ: dict[str, str] | None = None) -> Config:
    """Read a configuration, apply the environment's overrides, validate.

    Args:
        name_or_path: a YAML file, or the name of a ready configuration (`demo`).
        environ: where overrides are looked for; the process's environment by default.

    Raises:
        ConfigError: with one line per fault: file, key, what is wrong, what would be right.
    """
    path = resources.find_config(name_or_path)
    data = read_yaml(path)
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: expected sections (robot:, sensors:, …) at the top")
    _override(data, os.environ if environ is None else environ)
    return parse(data, str(path))


def parse(data: dict[str, Any], path: str = "<defaults>") -> Config:
    """Validate a mapping; see `load`."""
    try:
        # An empty section, so that its fault is the key that it lacks.
        config = Config.model_validate({"perception": {}, **data, "path": path})
    except ValidationError as error:
        raise ConfigError("\n".join(explain(f, path, Config) for f in error.errors())) from None
    config.check_policy()
    return config


def _with_default(data: dict[str, Any], path: tuple[str, ...], value: float) -> dict[str, Any]:
    """The data with a value where nothing is set there; as they are where a section is none."""
    key, *rest = path
    if not rest:
        return {key: value, **data}
    below = data.get(key) or {}
    if not isinstance(below, dict):
        return data
    return {**data, key: _with_default(below, tuple(rest), value)}


def _override(data: dict[str, Any], environ: dict[str, str] | os._Environ[str]) -> None:
    """Put `EDGE__A__B=value` (value read as YAML) into data[a][b], in place."""
    for key in sorted(k for k in environ if k.startswith(ENV_PREFIX)):
        *sections, leaf = key[len(ENV_PREFIX) :].lower().split("__")
        node = data
        for section in sections:
            child = node.get(section)
            if not isinstance(child, dict):
                child = node[section] = {}
            node = child
        try:
            node[leaf] = parse_yaml(environ[key])
        except ValueError:
            raise ConfigError(
                f"environment {key}: not a YAML value: {without_secrets(environ[key])!r:.80}"
            ) from None
