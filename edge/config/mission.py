"""The section of the mission: the instruction, its translator and its planner."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Union

from pydantic import Discriminator, Field, Tag

from edge.config.section import MODULE_CLASS, FilePath, Name, PluginKind, Positive, Section, kind_of

SMALL_TRANSLATOR = "mini-translator"
"""Card of the small translation network."""


class TranslatorLtl(Section):
    """No translation: the instruction is a formula of linear temporal logic (LTL)."""

    kind: Literal["ltl"] = "ltl"


class TranslatorGrammar(Section):
    """Rules for controlled English; no model, no network."""

    kind: Literal["grammar"] = "grammar"


class TranslatorLlm(Section):
    """A language model on an OpenAI-compatible server.

    Attributes:
        url: base URL of the server.
        model: name of the model on the server.
        api_key_env: environment variable that holds the API key.
        constrain: how the server gets the grammar of the answer: `gbnf` for llama.cpp,
            `guided_grammar` for vLLM from 0.11 on. `none`: only the limits of time and size apply.
        time_limit_s: time for one answer.
    """

    kind: Literal["llm"] = "llm"
    url: str = "http://127.0.0.1:8080/v1"
    model: str = "default"
    api_key_env: str = "OPENAI_API_KEY"
    constrain: Literal["gbnf", "guided_grammar", "none"] = "none"
    time_limit_s: Positive = 30.0


class TranslatorModel(Section):
    """A small network that runs here. If it is not sure, it asks which reading is meant."""

    kind: Literal["model"] = "model"
    card: Name = SMALL_TRANSLATOR


class TranslatorAuto(Section):
    """First the grammar. If it refuses, the small network; if that is not sure, `llm`, if given.

    If the last two disagree, the user is asked which reading is meant.

    Attributes:
        card: name of the small network's model card.
        llm: settings of the language model; null: none is used. If its server fails or hangs, the
            others translate without it.
    """

    kind: Literal["auto"] = "auto"
    card: Name = SMALL_TRANSLATOR
    llm: TranslatorLlm | None = None


Translator = Annotated[
    Union[TranslatorLtl, TranslatorGrammar, TranslatorModel, TranslatorLlm, TranslatorAuto],
    Field(discriminator="kind"),
]


class PlannerVitl(Section):
    """Shortest path over the automaton of the mission (ViTL eq. 1 and 2).

    Attributes:
        weights: cost of a step to an object. `constant`: 0.01 if it was detected, else 1, as in
            the paper. `distance`: the driving distance to a known object, 10 m for an unknown
            one; the plan then also changes when another plan is clearly shorter.
    """

    kind: Literal["vitl"] = "vitl"
    weights: Literal["constant", "distance"] = "constant"


class PlannerInOrder(Section):
    """Targets in the order of the instruction, whatever was detected: an evaluation baseline."""

    kind: Literal["in_order"] = "in_order"


class PlannerPlugin(Section):
    """Your own planner class. The tick waits for it, so it must be fast.

    Attributes:
        kind: the class as `module:Class`; the module's folder must be on PYTHONPATH.
        options: arguments of the class.
    """

    kind: PluginKind = MODULE_CLASS
    options: dict[str, Any] = Field(default_factory=dict)


class MissionConfig(Section):
    """The mission, and its limits.

    Attributes:
        target: object to find and reach. Ignored if `instruction` is set.
        instruction: the mission in words, for `translator`. Try it with `edge mission explain`.
        reading: number of the reading that is meant (from 1), if the instruction has several. null:
            the strictest one, which fulfils all others; if there is none, the mission is refused.
        translator: translates the instruction to a formula (LTL).
        planner: chooses the next target.
        compiler: makes the automaton: `own`, or `spot`, if the package Spot is installed.
        max_targets: most different objects in a mission.
        checkpoint: file to continue the mission from after a restart. Map and objects are saved
            next to it, as `<checkpoint>.map` (docs/service.md). null: nothing is saved.
        site: GeoJSON file of places and zones, read at the start and written when one
            changes (docs/places.md). null: they last until the service stops.
        on_request: true: start without a mission and wait for `edge mission new`, unless the
            command line gives a mission.
        search_limit_s: a target that is searched for this time without success counts as failed;
            the mission may reach another one instead. null: no limit.
        time_limit_s: the mission fails after this time, without waits, explorations and tours.
        path_limit_m: the mission fails after this driven distance, without explorations and tours.
        reach_m: the target is reached if the robot stops within this distance of its surface and
            the detector confirms it.
        verify_s: an object that is not confirmed after this time nearby is rejected.
        stuck_s: a robot that does not move for this time, although it has a goal, is stuck.
        discard_s: a goal that failed is not chosen again for this time, which doubles with each
            failure at the same place.
        probable: what to do if a search ends, or comes to its limits, without a confirmed object,
            but an object was rejected only because the detector was not sure. `refuse`: the target
            fails. `ask`: the robot goes back to it and waits 60 s for `edge mission confirm`.
            `accept`: it goes back, and the target counts as reached, "probably".
    """

    target: Name = "chair"
    instruction: Annotated[str, Field(min_length=1, max_length=10000)] | None = None
    reading: Annotated[int, Field(ge=1)] | None = None
    translator: Translator = TranslatorAuto()
    planner: Annotated[
        Union[
            Annotated[PlannerVitl, Tag("vitl")],
            Annotated[PlannerInOrder, Tag("in_order")],
            Annotated[PlannerPlugin, Tag(MODULE_CLASS)],
        ],
        Discriminator(kind_of),
    ] = PlannerVitl()
    compiler: Literal["own", "spot"] = "own"
    max_targets: Annotated[int, Field(ge=1, le=40)] = 16
    checkpoint: FilePath | None = None
    site: FilePath | None = None
    on_request: bool = False
    search_limit_s: Positive | None = None
    time_limit_s: Positive = 300.0
    path_limit_m: Positive = 100.0
    reach_m: Annotated[float, Field(gt=0, le=1.0)] = 0.9
    verify_s: Positive = 2.0
    stuck_s: Positive = 12.0
    discard_s: Positive = 45.0
    probable: Literal["refuse", "ask", "accept"] = "refuse"
