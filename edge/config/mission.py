"""What to do: the instruction, its translator and its planner."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Union

from pydantic import Discriminator, Field, Tag

from edge.config.section import (
    MODULE_CLASS,
    Name,
    OwnKind,
    Positive,
    Section,
    kind_of,
)

SMALL_TRANSLATOR = "mini-translator"


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


class TranslatorModel(Section):
    """A small network of our own, read from a model card; it asks where it is in doubt."""

    kind: Literal["model"] = "model"
    card: Name = SMALL_TRANSLATOR


class TranslatorAuto(Section):
    """The grammar; what it refuses, the small model; what that is not sure of, `llm`, where it is
    given. Where those two differ, whoever gave the instruction is asked."""

    kind: Literal["auto"] = "auto"
    card: Name = SMALL_TRANSLATOR
    llm: TranslatorLlm | None = None


Translator = Annotated[
    Union[TranslatorLtl, TranslatorGrammar, TranslatorModel, TranslatorLlm, TranslatorAuto],
    Field(discriminator="kind"),
]


class PlannerVitl(Section):
    """ViTL eq. 1 and 2: the shortest path under constant weights, or under driving distances.

    With `weights: distance` a known object weighs the metres to it, an unknown one
    `explore_m`, and the plan also changes when another is clearly shorter.
    """

    kind: Literal["vitl"] = "vitl"
    weights: Literal["constant", "distance"] = "constant"
    explore_m: Positive = 10.0


class PlannerInOrder(Section):
    """Targets as the instruction names them, whatever was seen: a baseline for evaluations."""

    kind: Literal["in_order"] = "in_order"


class PlannerOwn(Section):
    """A class of your own, on Python's path; `options` are its arguments. The tick waits for it."""

    kind: OwnKind = MODULE_CLASS
    options: dict[str, Any] = Field(default_factory=dict)


class Mission(Section):
    """What to do, and when to give up. `instruction` takes the place of `target` (which means
    just "reach it") and is read by `translator`; see `edge mission explain`. `reading` is which one
    of its readings is meant, where it has several; without it the one that fulfils all others is
    taken, and where there is none, it is refused. A target that was
    pursued for `search_limit_s` in vain has failed; another branch of the mission may be left.
    `max_states` and `compile_limit_steps` bound the work of compiling it, in counts that are the
    same on every machine: the default takes a few seconds at most.
    `checkpoint` is the file that a mission goes on from after a restart; what was mapped and seen
    is kept beside it, in a file of that name and `.map` (docs/service.md).
    `site` is a GeoJSON file of places, zones and room names, read at the start and written when one
    changes (docs/places.md).
    `on_request`: none is begun at the start, unless the command line names one; the robot stands
    until it is asked for one."""

    target: Name = "chair"
    instruction: Annotated[str, Field(min_length=1, max_length=10000)] | None = None
    reading: Annotated[int, Field(ge=1)] | None = None
    translator: Translator = TranslatorAuto()
    planner: Annotated[
        Union[
            Annotated[PlannerVitl, Tag("vitl")],
            Annotated[PlannerInOrder, Tag("in_order")],
            Annotated[PlannerOwn, Tag(MODULE_CLASS)],
        ],
        Discriminator(kind_of),
    ] = PlannerVitl()
    compiler: Literal["own", "spot"] = "own"
    compile_limit_steps: Annotated[int, Field(ge=1)] = 30_000_000
    max_states: Annotated[int, Field(ge=2)] = 20000
    max_targets: Annotated[int, Field(ge=1, le=40)] = 16
    checkpoint: str | None = None
    site: str | None = None
    on_request: bool = False
    search_limit_s: Positive | None = None
    time_limit_s: Positive = 300.0
    path_limit_m: Positive = 100.0
    reach_m: Annotated[float, Field(gt=0, le=1.0)] = 0.9
    verify_s: Positive = 2.0
    stuck_s: Positive = 12.0
    discard_s: Positive = 45.0
