"""The configuration: one YAML file is read into frozen, validated objects.

`load` takes the name of a built-in configuration, or the path of a YAML file. A variable of the
environment overrides one key: `EDGE__POLICY__KIND=nearest_frontier` sets `policy.kind`. All values
are checked here, once; the loop checks nothing.

Example:
    >>> from edge.config import load
    >>> load("demo", {"EDGE__POLICY__KIND": "nearest_frontier"}).policy.kind
    'nearest_frontier'
"""

from edge.config.loop import HttpConfig, LoopConfig, ReportConfig, SourceConfig, ZenohConfig
from edge.config.mapping import MAX_RADIUS_CELLS, MappingConfig
from edge.config.mcp import McpConfig
from edge.config.mission import (
    MissionConfig,
    PlannerInOrder,
    PlannerPlugin,
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
    LoadSheddingConfig,
    ModelProcessConfig,
    PerceptionConfig,
    SegmenterGrabcut,
    SegmenterNone,
    SegmenterOnnx,
    SwapConfig,
)
from edge.config.policy import (
    UNKNOWN_RADIUS_M,
    PolicyAdaptive,
    PolicyDirectional,
    PolicyHvl,
    PolicyNearest,
    PolicyPlugin,
    PolicySearch,
    PolicyVlfm,
)
from edge.config.robot import Camera, Lidar, MotionConfig, RobotConfig, SensorsConfig
from edge.config.root import Config, load, parse
from edge.config.ros2 import Ros2Config
from edge.config.section import OnnxModel, Section
from edge.config.sim import (
    SimConfig,
    WorldFurnished,
    WorldGenerated,
    WorldHouse,
    WorldMesh,
    WorldProcthor,
    WorldStreet,
)
from edge.config.tasks import (
    PipelinePlugin,
    TasksConfig,
    TrajectoryLimits,
    WriterModel,
    WriterRules,
)
from edge.errors import ConfigError
