"""The section of tasks: trajectories from instructions in free language (OpenNav III-A)."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Union

from pydantic import Field

from edge.config.section import OnnxModel, PluginKind, Positive, Section


class TrajectoryLimits(Section):
    """Limits of a trajectory, when it is written and when it is refined.

    Attributes:
        clearance_m: distance of the robot's middle from occupied cells. Default: 0.3 m, or
            `robot.radius_m` plus 0.1 m if that is larger.
        max_jump_m: longest distance between two points.
        max_length_m: longest trajectory.
        max_speed_mps: highest speed that an instruction can ask for; the lowest is 0.05 m/s.
    """

    clearance_m: Annotated[float, Field(ge=0, le=10)] = 0.3
    max_jump_m: Annotated[float, Field(ge=0.1, le=100)] = 2.0
    max_length_m: Annotated[float, Field(ge=0.1, le=1e6)] = 500.0
    max_speed_mps: Annotated[float, Field(ge=0.05, le=100)] = 2.0


class WriterRules(Section):
    """Rules for a small grammar (`edge.tasks.rules`); no model, no network."""

    kind: Literal["rules"] = "rules"


class WriterModel(Section):
    """A multimodal model on an OpenAI-compatible server writes a script (OpenNav algorithm 1).

    If the script has an error, the model gets the error and answers again.

    Attributes:
        url: base URL of the server.
        model: name of the model on the server.
        api_key_env: environment variable that holds the API key.
        picture: false: send no image, only text, as LLM-TG does.
        max_attempts: most answers for one trajectory.
        time_limit_s: time for all answers together.
    """

    kind: Literal["model"] = "model"
    url: str = "http://127.0.0.1:8080/v1"
    model: str = "default"
    api_key_env: str = "OPENAI_API_KEY"
    picture: bool = True
    max_attempts: Annotated[int, Field(ge=1, le=20)] = 4
    time_limit_s: Positive = 120.0


class PipelinePlugin(Section):
    """Your own function or class that returns an `edge.tasks.scene.pipeline.PerceptionPipeline`.

    It gets the options. If it has parameters of these names, it also gets `perception` (that
    section) and `words` (names of the objects to find).

    Attributes:
        kind: the function or class as `module:Name`; the module's folder must be on PYTHONPATH.
        options: arguments of the function or class.
    """

    kind: PluginKind
    options: dict[str, Any] = Field(default_factory=dict)


class TasksConfig(Section):
    """Tasks: instructions that describe a way to drive.

    Attributes:
        pipeline: your own models for `edge trajectory --objects detector` and
            `edge eval trajectories --detector`. null: `perception.detector` and
            `perception.segmenter`, which the service always uses.
        ground: model that names the class of each pixel, such as SegFormer (a card of task
            `ground`), for kinds of ground: in the service, in `edge trajectory --objects detector`
            and in `edge eval trajectories --detector`. null: all ground is of one kind.
        planner: writes the trajectories.
    """

    ground: OnnxModel | None = None
    pipeline: PipelinePlugin | None = None
    planner: Annotated[Union[WriterRules, WriterModel], Field(discriminator="kind")] = WriterRules()
    trajectory: TrajectoryLimits = TrajectoryLimits()
