"""The configuration: one YAML file is read into frozen, validated objects.

`load` takes the name of a ready configuration, or the path of a YAML file. A variable of the
environment overrides one key: `EDGE__POLICY__KIND=nearest_frontier` sets `policy.kind`. All values
are checked here, once; the loop checks nothing.

Example:
    >>> from edge.config import load
    >>> load("demo", {"EDGE__POLICY__KIND": "nearest_frontier"}).policy.kind
    'nearest_frontier'
"""

from edge.config.loop import Http, Loop, Report, Source, Zenoh
from edge.config.mapping import Mapping
from edge.config.mission import (
    Mission,
    PlannerInOrder,
    PlannerOwn,
    PlannerVitl,
    Translator,
    TranslatorAuto,
    TranslatorGrammar,
    TranslatorLlm,
    TranslatorLtl,
    TranslatorModel,
)
from edge.config.perception import (
    ChoiceCooccurrence,
    ChoiceNone,
    ChoiceOnnx,
    ChoiceOpenai,
    ChoiceText,
    DetectorOnnx,
    DetectorSim,
    Governor,
    ModelProcess,
    Perception,
    SegmenterGrabcut,
    SegmenterNone,
    SegmenterOnnx,
    Swap,
)
from edge.config.policy import (
    PolicyAdaptive,
    PolicyDirectional,
    PolicyHvl,
    PolicyNearest,
    PolicyOwn,
    PolicySearch,
    PolicyVlfm,
)
from edge.config.robot import Camera, Lidar, Motion, Robot, Sensors
from edge.config.root import Config, load, parse
from edge.config.ros2 import Ros2
from edge.config.section import Section
from edge.config.sim import Sim, WorldGenerated, WorldHouse, WorldMesh, WorldProcthor, WorldStreet
from edge.config.tasks import (
    ChainOwn,
    Tasks,
    TrajectoryLimits,
    WriterModel,
    WriterRules,
)
from edge.errors import ConfigError

__all__ = [
    "Camera",
    "ChainOwn",
    "ChoiceCooccurrence",
    "ChoiceNone",
    "ChoiceOnnx",
    "ChoiceOpenai",
    "ChoiceText",
    "Config",
    "ConfigError",
    "DetectorOnnx",
    "DetectorSim",
    "Governor",
    "Http",
    "Lidar",
    "Loop",
    "Mapping",
    "Mission",
    "ModelProcess",
    "Motion",
    "Perception",
    "PlannerInOrder",
    "PlannerOwn",
    "PlannerVitl",
    "PolicyAdaptive",
    "PolicyDirectional",
    "PolicyHvl",
    "PolicyNearest",
    "PolicyOwn",
    "PolicySearch",
    "PolicyVlfm",
    "Report",
    "Robot",
    "Ros2",
    "Section",
    "SegmenterGrabcut",
    "SegmenterNone",
    "SegmenterOnnx",
    "Sensors",
    "Sim",
    "Source",
    "Swap",
    "Tasks",
    "TrajectoryLimits",
    "Translator",
    "TranslatorAuto",
    "TranslatorGrammar",
    "TranslatorLlm",
    "TranslatorLtl",
    "TranslatorModel",
    "WorldGenerated",
    "WorldHouse",
    "WorldMesh",
    "WorldProcthor",
    "WorldStreet",
    "WriterModel",
    "WriterRules",
    "Zenoh",
    "load",
    "parse",
]
