"""Checks of a configuration against this installation, before anything is loaded or compiled.

`edge run` and `edge demo` start with these checks, and `edge config` ends with them, so all report
the same errors. Nothing is opened and no server is asked. Ports, servers and the content of model
files are checked when the service opens them, before it compiles its kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from typing import NamedTuple

from edge.bus.session import check_settings
from edge.chat import ChatError, make_chat_client
from edge.config import (
    ChoiceOnnx,
    ChoiceOpenai,
    ChoiceText,
    Config,
    DetectorOnnx,
    PlannerPlugin,
    SegmenterOnnx,
    WriterModel,
)
from edge.errors import UserError
from edge.host.credentials import read_token
from edge.mission.planning.planner import find_plugin_planner
from edge.mission.translate import make_translator
from edge.perception.embedding.encoders import check_text_encoder, make_text_encoder
from edge.perception.embedding.text import PromptError
from edge.perception.runtime.card_types import (
    Card,
    ChoiceCard,
    DetectCard,
    GroundCard,
    ImageCard,
    MarksCard,
    SegmentCard,
    SimilarityCard,
    TranslateCard,
)
from edge.perception.runtime.cards import check_installed, load_card, load_card_of
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.sessions import CPU_ONLY, check_providers
from edge.perception.scoring.choice.mark_scorer import check_size
from edge.perception.scoring.choice.server import make_server_scorer
from edge.perception.scoring.similarity import is_running_detector
from edge.perception.scoring.vlm.files import EXTRA
from edge.policies import find_policy
from edge.sinks import find_sinks
from edge.sources import find_source
from edge.tasks import script
from edge.tasks.mission_spec import prepare_mission


def check(config: Config, use_onnxruntime: bool = True) -> None:
    """Raise UserError if the service cannot run with this configuration.

    Args:
        config: the configuration.
        use_onnxruntime: False leaves out what needs this library, for example because it crashes.

    Raises:
        UserError: one line for each fault, with the exit code of the first.
    """
    faults: list[UserError] = []
    checks = _CHECKS + ((_check_translator,) if use_onnxruntime else ())
    models = (partial(_check_model, model, use_onnxruntime) for model in named_models(config))
    for run_check in (*checks, *models):
        try:
            run_check(config)
        except UserError as error:
            faults.append(error)
    if not faults:
        return
    if len(faults) == 1:
        raise faults[0]
    combined = UserError("\n".join(dict.fromkeys(map(str, faults))))
    combined.exit_code = faults[0].exit_code
    raise combined


def check_mission(config: Config) -> None:
    """Raise UserError if the configured mission cannot be understood or done.

    It is not checked if a language model on a server may have to translate it, or if a checkpoint
    may hold another mission.

    Raises:
        UserError: one line: the mission is not understood, is impossible, or names an object that
            the detector does not know.
    """
    mission = config.mission
    translator = mission.translator
    by_server = translator.kind == "llm" or getattr(translator, "llm", None) is not None
    if mission.checkpoint is not None or (mission.instruction is not None and by_server):
        return
    spec, detector = prepare_mission(config), config.perception.detector
    if isinstance(detector, DetectorOnnx):
        card = load_card_of(DetectCard, detector.model)
        make_text_encoder(card, detector.vocabulary).embed(spec.prompts)


def _check_policy(config: Config) -> None:
    find_policy(config.policy, config.origin("policy"))


def _check_planner(config: Config) -> None:
    if isinstance(config.mission.planner, PlannerPlugin):
        find_plugin_planner(config.mission.planner, config.locate("mission.planner"))


def _check_bus(config: Config) -> None:
    check_settings(config.zenoh, "listen")


def _check_http(config: Config) -> None:
    if config.http.token_file is not None:
        read_token("http.token_file", config.http.token_file)


def _check_translator(config: Config) -> None:
    translator = config.mission.translator
    if (card := getattr(translator, "card", None)) is not None:
        with _prefix_errors(config, "mission.translator.card"):
            load_card_of(TranslateCard, card)
    with _prefix_errors(config, "mission.translator"):
        make_translator(translator)


def _check_choice(config: Config) -> None:
    choice = config.perception.choice
    if isinstance(choice, (ChoiceOpenai, ChoiceText)):
        make_server_scorer(choice).close()


def _check_tasks(config: Config) -> None:
    if isinstance(config.tasks.planner, WriterModel):
        with _prefix_errors(config, "tasks.planner"):
            make_chat_client(config.tasks.planner).close()
        script.version()


_CHECKS: tuple[Callable[[Config], object], ...] = (
    find_source, find_sinks, _check_policy, _check_planner, _check_bus, _check_http, _check_choice,
    _check_tasks,
)  # fmt: skip


class NamedModel(NamedTuple):
    """A model that a configuration names.

    Attributes:
        providers: execution providers that it shall run on.
    """

    key: str
    name: str
    kind: type[Card]
    providers: Sequence[str]


def named_models(config: Config) -> Iterator[NamedModel]:
    """Yield each model that the sections perception and tasks name."""
    perception = config.perception
    detector, segmenter, choice = perception.detector, perception.segmenter, perception.choice
    providers: Sequence[str] = CPU_ONLY
    if isinstance(detector, DetectorOnnx):
        providers = detector.providers
        yield NamedModel("perception.detector.model", detector.model, DetectCard, providers)
        if detector.fallback is not None:
            key = "perception.detector.fallback"
            yield NamedModel(key, detector.fallback, DetectCard, providers)
    for i, level in enumerate(perception.load_shedding.levels):
        if level.model is not None:
            key = f"perception.load_shedding.levels.{i}.model"
            yield NamedModel(key, level.model, DetectCard, providers)
    if isinstance(segmenter, SegmenterOnnx):
        key = "perception.segmenter.model"
        yield NamedModel(key, segmenter.model, SegmentCard, segmenter.providers)
    if (ground := config.tasks.ground) is not None:
        yield NamedModel("tasks.ground.model", ground.model, GroundCard, ground.providers)
    if perception.similarity is not None:
        yield NamedModel("perception.similarity", perception.similarity, SimilarityCard, providers)
    if isinstance(choice, ChoiceOnnx):
        yield NamedModel("perception.choice.card", choice.card, ChoiceCard, choice.providers)
    elif isinstance(choice, (ChoiceOpenai, ChoiceText)) and choice.fallback is not None:
        yield NamedModel("perception.choice.fallback", choice.fallback, ChoiceCard, CPU_ONLY)


def _check_model(model: NamedModel, use_onnxruntime: bool, config: Config) -> None:
    """Check the card of a model and the cards that it refers to: files, packages, providers."""
    with _prefix_errors(config, model.key):
        cards = list(_checked_cards(config, model.name, model.kind))
    if any(file.server is None for card in cards for file in card.files):
        # A model in a separate process must not load onnxruntime into this one.
        isolated = config.perception.isolation == "process"
        is_asked = use_onnxruntime and not isolated
        ask_onnxruntime = is_asked and tuple(model.providers) != CPU_ONLY
        check_providers(
            model.providers, f"{model.key.rpartition('.')[0]}.providers", ask_onnxruntime
        )


def _checked_cards(config: Config, name: str, kind: type[Card]) -> Iterator[Card]:
    """Yield a card and the cards that it refers to; check that all they need is installed."""
    card = load_card(name)
    # A choice model may have either of two cards; every other model has the card of its kind.
    if kind is not ChoiceCard or not isinstance(card, MarksCard):
        card = load_card_of(kind, name)
    check_installed(card)
    yield card
    perception = config.perception
    detector = perception.detector
    vocabulary = detector.vocabulary if isinstance(detector, DetectorOnnx) else None
    if isinstance(card, DetectCard):
        check_text_encoder(card.text_encoder, vocabulary)
    elif isinstance(card, MarksCard) and isinstance(perception.choice, ChoiceOnnx):
        check_size(card, perception.choice)
        check_text_encoder(card.text_encoder, None)
    elif isinstance(card, ChoiceCard):
        for package in ("tokenizers", "jinja2"):
            if find_spec(package) is None:
                raise ModelError(
                    f"model {card.name}: needs the package {package}, which is not installed; "
                    f"{EXTRA}"
                )
    elif isinstance(card, SimilarityCard) and not is_running_detector(card, perception):
        if card.detector is not None:
            yield from _checked_cards(config, card.detector, DetectCard)
        else:
            yield from _checked_cards(config, str(card.image_encoder), ImageCard)
            check_text_encoder(card.text_encoder, vocabulary)


@contextmanager
def _prefix_errors(config: Config, key: str) -> Iterator[None]:
    """Prefix errors of the block with the key of the configuration."""
    try:
        yield
    except (ModelError, PromptError, ChatError) as error:
        raise type(error)(f"{config.locate(key)}: {error}") from None
