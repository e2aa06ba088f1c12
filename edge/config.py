"""The configuration: one YAML file in, frozen and validated objects out.

`load("demo")` finds a ready configuration by name, `load("my/robot.yaml")` a file.
`EDGE__POLICY__KIND=nearest_frontier` in the environment overrides `policy.kind`.
Everything is checked here, once; the loop checks nothing.
"""

from __future__ import annotations

import os
from typing import Annotated, Any, Literal, Union

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from edge import resources
from edge.config_faults import explain
from edge.errors import UserError

ENV_PREFIX = "EDGE__"

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]


class ConfigError(UserError):
    """A configuration that cannot be used; the message names file, key and choices."""


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Robot(Section):
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")] = "robot"
    radius_m: Positive = 0.2
    height_m: Positive = 0.8
    max_speed_mps: Positive = 0.5
    max_turn_radps: Positive = 1.2
    max_accel_mps2: Positive = 1.0
    max_turn_accel_radps2: Positive = 3.0


class Camera(Section):
    """A forward camera on the robot; intrinsics serve the simulator, a real one sends its own."""

    width_px: Annotated[int, Field(ge=16, le=4096)] = 320
    height_px: Annotated[int, Field(ge=16, le=4096)] = 256
    hfov_deg: Annotated[float, Field(gt=10, lt=150)] = 75.0
    x_m: float = 0.1
    z_m: Positive = 0.6
    pitch_deg: float = 5.0
    rate_hz: Positive = 30.0
    depth_min_m: NonNegative = 0.1
    depth_max_m: Positive = 8.0


class Lidar(Section):
    """A 2D (`rings: 1`) or 3D LiDAR; `pitch_deg` tilts it nose down (VL-Nav: 23 degrees)."""

    rings: Annotated[int, Field(ge=1, le=256)] = 16
    columns: Annotated[int, Field(ge=16, le=4096)] = 720
    vfov_deg: Annotated[float, Field(gt=0, le=170)] = 60.0
    x_m: float = 0.0
    z_m: Positive = 0.5
    pitch_deg: float = 0.0
    rate_hz: Positive = 10.0
    range_m: Positive = 20.0
    noise_m: NonNegative = 0.01


class Sensors(Section):
    camera: Camera = Camera()
    lidar: Lidar | None = None
    odometry_hz: Positive = 60.0


class Zenoh(Section):
    """The service listens; simulator and controller connect to the same endpoint."""

    endpoint: str = "tcp/127.0.0.1:7447"
    prefix: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$")] = "edge"
    mode: Literal["peer", "client"] = "peer"
    shared_memory: bool = True


class Source(Section):
    """Limits on what is let in; everything outside is dropped and counted."""

    max_message_mb: Positive = 64.0
    max_pose_gap_s: Positive = 0.25
    max_pose_jump_m: Positive = 1.0
    max_cloud_points: Annotated[int, Field(ge=16)] = 131072
    pool_slots: Annotated[int, Field(ge=3, le=32)] = 6
    odometry_ring: Annotated[int, Field(ge=64)] = 256


class Loop(Section):
    """`priority` is the loop's among real-time threads (SCHED_FIFO; 0 = an ordinary thread).

    `lockstep` waits for nothing in real time: every observation is one tick and the
    detector runs inside it every `detect_every` ticks, so a run replays the same."""

    hz: Positive = 30.0
    priority: Annotated[int, Field(ge=0, le=99)] = 0
    lockstep: bool = False
    detect_every: Annotated[int, Field(ge=1)] = 1


class Mapping(Section):
    """The rolling occupancy map (VL-Nav III.A, III.B)."""

    input: Literal["depth", "cloud"] = "depth"
    resolution_m: Annotated[float, Field(ge=0.01, le=1.0)] = 0.05
    extent_m: Positive = 50.0
    range_m: Positive = 5.0
    min_range_m: NonNegative = 0.1
    inflation_m: NonNegative = 0.25
    obstacle_min_m: Positive = 0.10
    obstacle_max_m: Positive = 1.0
    ground_slope: NonNegative = 0.3
    clear_after: Annotated[int, Field(ge=1, le=100)] = 2
    frontier_min_cells: Annotated[int, Field(ge=1)] = 6
    frontier_large_cells: Annotated[int, Field(ge=2)] = 40
    frontier_spacing_m: Positive = 1.0
    max_frontiers: Annotated[int, Field(ge=8, le=4096)] = 256
    reach_cells_per_tick: Annotated[int, Field(ge=100)] = 8000

    @model_validator(mode="after")
    def _fits(self) -> Mapping:
        if self.extent_m < 2 * (self.range_m + 2 * self.inflation_m) + 1.0:
            raise ValueError("extent_m: must be over twice range_m plus inflation on both sides")
        if self.obstacle_max_m <= self.obstacle_min_m:
            raise ValueError("obstacle_max_m: must be above obstacle_min_m")
        return self


class DetectorOnnx(Section):
    """An ONNX detector; `model` names a card in `models/`.

    `providers` are onnxruntime's, in the order of preference, or `tensorrt` alone: TensorRT itself,
    without onnxruntime. `device_id` is the GPU. Engines of TensorRT are kept in `engine_cache`, by
    default beside the models.
    """

    kind: Literal["onnx"] = "onnx"
    model: str = "yolo-world-s-256x320-int8-cpu"
    providers: tuple[str, ...] = ("CPUExecutionProvider",)
    threads: Annotated[int, Field(ge=1, le=64)] = 2
    vocabulary: str | None = None
    background: tuple[str, ...] = ()
    nms_iou: Fraction = 0.5
    max_detections: Annotated[int, Field(ge=1, le=1000)] = 64
    tau_vl: Fraction = 0.05
    device_id: Annotated[int, Field(ge=0)] = 0
    engine_cache: str | None = None


class DetectorSim(Section):
    """Object ids from the simulator's ray caster with a noise model: no neural network."""

    kind: Literal["sim"] = "sim"
    max_range_m: Positive = 6.0
    min_visible_px: Annotated[int, Field(ge=1)] = 40
    miss_rate: Fraction = 0.1
    false_positive_rate: Fraction = 0.005
    score_noise: NonNegative = 0.08
    tau_vl: Fraction = 0.05
    seed: int = 0


class ModelProcess(Section):
    """How a model in a process of its own is looked after (`isolation: process`).

    A frame that takes longer than `timeout_s` counts as a hang; what the worker waited for a core
    is added to that, at most as much again. A worker that ended is started again after
    `backoff_s`, twice as long each time up to `backoff_max_s`, and at most `restarts` times within
    `window_s`: beyond that the detector is `degraded`.
    """

    timeout_s: Positive = 0.8
    start_timeout_s: Positive = 60.0
    backoff_s: Positive = 0.2
    backoff_max_s: Positive = 5.0
    restarts: Annotated[int, Field(ge=0)] = 8
    window_s: Positive = 60.0


class Swap(Section):
    """What a model must do to take another's place in the running service.

    It is tried on the last `images` images: finite, at most `budget_ms` at the median, and, where
    both are of one family, `min_recall` of the boxes above `tau_det` that the old one finds. The
    old one is kept until the new one has run clean on `probation` images.
    """

    images: Annotated[int, Field(ge=1, le=32)] = 4
    budget_ms: Positive = 33.0
    min_recall: Fraction = 0.5
    probation: Annotated[int, Field(ge=1)] = 60
    load_timeout_s: Positive = 600.0


class ChoiceNone(Section):
    """No model is asked which way to go."""

    kind: Literal["none"] = "none"


class ChoiceOpenai(Section):
    """ViTL eq. 4 and 5 by a server that speaks OpenAI's protocol, with images and logprobs.

    `rest_s` is how long after an answer the next question is asked; a paid server's price.
    """

    kind: Literal["openai"] = "openai"
    url: str
    model: str
    api_key_env: str = "OPENAI_API_KEY"
    time_limit_s: Positive = 5.0
    rest_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    max_image_px: Annotated[int, Field(ge=64, le=4096)] = 640


class ChoiceText(Section):
    """The same by a language model without eyes, told what was detected and where."""

    kind: Literal["text"] = "text"
    url: str
    model: str
    api_key_env: str = "OPENAI_API_KEY"
    time_limit_s: Positive = 5.0
    rest_s: Annotated[float, Field(ge=0, le=3600)] = 0.0


class Perception(Section):
    """`similarity` names the card of an image-text scorer (VLFM's score), if one is to run."""

    isolation: Literal["thread", "process"] = "thread"
    process: ModelProcess = ModelProcess()
    swap: Swap = Swap()
    similarity: str | None = None
    choice: Annotated[Union[ChoiceNone, ChoiceOpenai, ChoiceText], Field(discriminator="kind")] = (
        ChoiceNone()
    )
    detector: Annotated[Union[DetectorOnnx, DetectorSim], Field(discriminator="kind")] = (
        DetectorSim()
    )
    tau_det: Fraction = 0.3
    lift: Literal["depth", "cloud"] = "depth"
    lift_min_points: Annotated[int, Field(ge=1)] = 8
    lift_max_range_m: Positive = 8.0
    voxel_m: Positive = 0.1
    merge_m: Positive = 0.6
    max_instances: Annotated[int, Field(ge=1, le=4096)] = 128
    min_hits: Annotated[int, Field(ge=1)] = 2
    confirm_score: Fraction = 0.35
    confirm_range_m: Positive = 3.0
    confirm_hits: Annotated[int, Field(ge=1)] = 3
    confirm_mean: Fraction = 0.12
    confirm_lead: Annotated[float, Field(ge=1)] = 1.5
    refute_radius_m: NonNegative = 0.6

    @model_validator(mode="after")
    def _isolable(self) -> Perception:
        if self.isolation == "process" and self.detector.kind != "onnx":
            raise ValueError(
                f"isolation: process: only for perception.detector.kind: onnx, "
                f"{self.detector.kind} runs in the service"
            )
        return self


class PolicyHvl(Section):
    """VL-Nav eq. 2-8 and algorithm 2; the two switches are its ablations (table I)."""

    kind: Literal["hvl"] = "hvl"
    sigma_rad: Positive = 0.1
    w_dist: NonNegative = 0.5
    w_vl: NonNegative = 1.0
    unknown_k: Positive = 2.0
    unknown_radius_m: Positive = 1.0
    delta_reached_m: NonNegative = 0.5
    r_assoc_m: Positive = 0.6
    instances: bool = True
    heuristics: bool = True
    switch_margin: NonNegative = 0.3


class PolicyNearest(Section):
    """The nearest frontier; instances first (a baseline)."""

    kind: Literal["nearest_frontier"] = "nearest_frontier"
    delta_reached_m: NonNegative = 0.5
    r_assoc_m: Positive = 0.6
    switch_margin: NonNegative = 0.3


class TranslatorLtl(Section):
    """The instruction is itself a formula of linear temporal logic."""

    kind: Literal["ltl"] = "ltl"


class TranslatorGrammar(Section):
    """Controlled English, read offline by rules."""

    kind: Literal["grammar"] = "grammar"


class TranslatorLlm(Section):
    """Any OpenAI-compatible server; `constrain` names what keeps its answer to a grammar: the
    field of llama.cpp, or that of vLLM from 0.11 on. Without it only the time and size limits hold.
    """

    kind: Literal["llm"] = "llm"
    url: str = "http://127.0.0.1:8080/v1"
    model: str = "default"
    api_key_env: str = "OPENAI_API_KEY"
    constrain: Literal["gbnf", "guided_grammar", "none"] = "none"
    time_limit_s: Positive = 30.0
    max_answer_kb: Positive = 64.0


class PlannerVitl(Section):
    """ViTL eq. 1 and 2: the shortest path under constant weights, or under driving distances.

    With `weights: distance` a known object weighs the metres to it, an unknown one
    `explore_m`, and the plan is also made anew when it gets better by `replan_margin_m`.
    `w_fail` is what a failed object counts in the costs that status shows: whatever it is, no plan
    needs one while another can do without.
    """

    kind: Literal["vitl"] = "vitl"
    weights: Literal["constant", "distance"] = "constant"
    w_det: Annotated[float, Field(gt=0, lt=1)] = 0.01
    w_fail: Annotated[float, Field(gt=1)] = 1000.0
    explore_m: Positive = 10.0
    replan_margin_m: NonNegative = 1.0


class PlannerExpected(Section):
    """Least expected cost: a stochastic shortest path over automaton and knowledge."""

    kind: Literal["expected"] = "expected"
    p_obs: Annotated[float, Field(gt=0, le=1)] = 0.5
    prior: Literal["constant", "cooccurrence"] = "constant"
    w_det: Annotated[float, Field(gt=0, lt=1)] = 0.01


class Mission(Section):
    """What to do, and when to give up. `instruction` takes the place of `target` (which means
    just "reach it") and is read by `translator`; see `edge mission explain`. A target that was
    pursued for `search_limit_s` in vain has failed; another branch of the mission may be left.
    `checkpoint` is the file that a mission goes on from after a restart."""

    target: Annotated[str, Field(min_length=1)] = "chair"
    instruction: Annotated[str, Field(min_length=1, max_length=10000)] | None = None
    translator: Annotated[
        Union[TranslatorLtl, TranslatorGrammar, TranslatorLlm], Field(discriminator="kind")
    ] = TranslatorGrammar()
    planner: Annotated[Union[PlannerVitl, PlannerExpected], Field(discriminator="kind")] = (
        PlannerVitl()
    )
    compiler: Literal["own", "spot"] = "own"
    compile_limit_s: Positive = 5.0
    max_states: Annotated[int, Field(ge=2)] = 20000
    max_targets: Annotated[int, Field(ge=1, le=40)] = 16
    checkpoint: str | None = None
    search_limit_s: Positive | None = None
    time_limit_s: Positive = 300.0
    path_limit_m: Positive = 100.0
    reach_m: Annotated[float, Field(gt=0, le=1.0)] = 0.9
    verify_s: Positive = 2.0
    stuck_s: Positive = 12.0
    discard_s: Positive = 45.0


class Motion(Section):
    """The reference motion controller: A* on the published map, pure pursuit.

    `clearance_m` is kept from occupied cells on top of the map's own inflation; `near_m` and
    `near_cost` make cells near obstacles dearer; `give_up_s` is how long a goal may stay
    without a path.
    """

    rate_hz: Positive = 20.0
    lookahead_m: Positive = 0.45
    goal_tolerance_m: Positive = 0.12
    yaw_tolerance_rad: Positive = 0.15
    replan_s: Positive = 0.5
    stuck_s: Positive = 4.0
    stuck_m: Positive = 0.05
    unknown_cost: Positive = 3.0
    clearance_m: NonNegative = 0.0
    near_m: Positive = 0.4
    near_cost: NonNegative = 4.0
    give_up_s: Positive = 3.0


class WorldHouse(Section):
    """A house of boxes, cylinders and the like; `house` names a built-in one or a JSON file."""

    kind: Literal["house"] = "house"
    house: str = "demo"


class WorldMesh(Section):
    """A textured mesh (extra `worlds`) with its objects' boxes."""

    kind: Literal["mesh"] = "mesh"
    mesh: str
    objects: str


class WorldProcthor(Section):
    """One house of a ProcTHOR JSON-lines file, as boxes."""

    kind: Literal["procthor"] = "procthor"
    file: str
    name: str


class Sim(Section):
    world: Annotated[Union[WorldHouse, WorldMesh, WorldProcthor], Field(discriminator="kind")] = (
        WorldHouse()
    )
    start: tuple[float, float, float] | None = None
    seed: int = 0
    lockstep: bool = False
    step_s: Positive = 0.1
    depth_noise: NonNegative = 0.0
    drift_m_per_m: NonNegative = 0.0
    drift_rad_per_rad: NonNegative = 0.0


class Report(Section):
    frames: Annotated[int, Field(ge=0, le=100)] = 8
    status_hz: Positive = 1.0
    map_hz: Positive = 2.0


class Config(Section):
    """A whole configuration; `path` is where it came from."""

    path: str = "<defaults>"
    robot: Robot = Robot()
    sensors: Sensors = Sensors()
    zenoh: Zenoh = Zenoh()
    source: Source = Source()
    loop: Loop = Loop()
    mapping: Mapping = Mapping()
    perception: Perception = Perception()
    policy: Annotated[Union[PolicyHvl, PolicyNearest], Field(discriminator="kind")] = PolicyHvl()
    mission: Mission = Mission()
    motion: Motion = Motion()
    sim: Sim = Sim()
    report: Report = Report()


def load(name_or_path: str, environ: dict[str, str] | None = None) -> Config:
    """Read a configuration, apply the environment's overrides, validate.

    Args:
        name_or_path: a YAML file, or the name of a ready configuration (`demo`).
        environ: where overrides are looked for; the process's environment by default.

    Raises:
        ConfigError: with one line per fault: file, key, what is wrong, what would be right.
    """
    path = resources.find_config(name_or_path)
    try:
        with open(path, encoding="utf-8") as file:
            data = yaml.safe_load(file)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: expected sections (robot:, sensors:, …) at the top")
    _override(data, os.environ if environ is None else environ)
    return parse(data, str(path))


def parse(data: dict[str, Any], path: str = "<defaults>") -> Config:
    """Validate a mapping; see `load`."""
    try:
        return Config.model_validate({**data, "path": path})
    except ValidationError as error:
        raise ConfigError("\n".join(explain(f, path, Config) for f in error.errors())) from None


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
            node[leaf] = yaml.safe_load(environ[key])
        except yaml.YAMLError:
            raise ConfigError(f"environment {key}: not a YAML value: {environ[key]!r}") from None
