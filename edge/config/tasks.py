"""Tasks in free language: who writes trajectories, within which limits (OpenNav III-A)."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Union

from pydantic import Field

from edge.config.section import OwnKind, Positive, Section


class TrajectoryLimits(Section):
    """What a trajectory has to keep to, as it is written and as it is refined. The robot's middle
    stays `clearance_m` from the rim of what is occupied; where it is not set, a wider robot keeps
    farther away. Two points are at most `max_jump_m` apart; a speed that is asked for is from
    0.05 to `max_speed_mps`, whatever the robot can do."""

    clearance_m: Annotated[float, Field(ge=0, le=10)] = 0.3
    max_jump_m: Annotated[float, Field(ge=0.1, le=100)] = 2.0
    max_length_m: Annotated[float, Field(ge=0.1, le=1e6)] = 500.0
    max_speed_mps: Annotated[float, Field(ge=0.05, le=100)] = 2.0


class WriterRules(Section):
    """Offline: what a small grammar understands, see `edge.tasks.rules`."""

    kind: Literal["rules"] = "rules"


class WriterModel(Section):
    """A multimodal model on any OpenAI-compatible server writes a script; what is wrong with it
    goes back, `rounds` times in all (OpenNav algorithm 1). `time_limit_s` is for all of them.
    Without `picture` the model gets the words alone, as LLM-TG does."""

    kind: Literal["model"] = "model"
    url: str = "http://127.0.0.1:8080/v1"
    model: str = "default"
    api_key_env: str = "OPENAI_API_KEY"
    picture: bool = True
    rounds: Annotated[int, Field(ge=1, le=20)] = 4
    time_limit_s: Positive = 120.0


class ChainOwn(Section):
    """What makes an `edge.tasks.chain.Chain`, a function or class of one's own on Python's path:
    called with `options`, and with `perception` (that section) and `words` (what is looked for), if
    it has parameters for them."""

    kind: OwnKind
    options: dict[str, Any] = Field(default_factory=dict)


class Tasks(Section):
    """`chain` is what `edge trajectory --objects detector` and `edge eval trajectories --detector`
    see by; null: `perception.detector` and `perception.segmenter`, by which a service sees."""

    chain: ChainOwn | None = None
    planner: Annotated[Union[WriterRules, WriterModel], Field(discriminator="kind")] = WriterRules()
    trajectory: TrajectoryLimits = TrajectoryLimits()
