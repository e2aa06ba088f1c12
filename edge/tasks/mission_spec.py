"""Preparation of every mission before it runs: a task in words, or a target or formula.

An instruction becomes a task if it describes a path that no mission can mean ("turn left", "go past
the right of the sofa"), or that passes an object and then stops ("go past the sofa and stop at the
bed").
"""

from __future__ import annotations

import re
from typing import Any

from edge import names
from edge.config import Config, TranslatorLtl, WriterModel
from edge.memory import Site
from edge.mission.instructions import MissionError
from edge.mission.language.errands.impossible import says_manner, without_manner
from edge.mission.language.intents import NoMissionError
from edge.mission.language.words import nouns
from edge.mission.language.words.places import quote_places
from edge.mission.language.words.tokens import UnclearError, unclear
from edge.mission.logic import ltl
from edge.mission.readings import AmbiguousInstructionError
from edge.mission.spec import MissionSpec, prepare, spec_of_task
from edge.mission.task_step import TaskStep
from edge.mission.translate import Translation, TranslationError
from edge.tasks.prompt import MOST_INSTRUCTION_CHARS
from edge.tasks.sentences.reading import (
    begins_with_path_word,
    describes_path,
    named_objects,
    noun_phrases,
    task_steps,
)

_NO_SITE = Site()  # without places
_MOST_WORDS = 4
"""Largest number of words in a name that `known_names` looks for."""
# Several objects of a kind, and a wait: a task has neither.
_MORE_THAN_A_PATH = re.compile(
    r"\b(?:all|every|each|both|another|other|any|some|people|wait)\b", re.I
)

# "past the sofa and stop at the bed": a mission would go to both, in any order.
_PASSES = re.compile(r"\bpast\b.*?,? and (?:then )?(?:stop|park|halt)\b", re.I)
_BANS = re.compile(r"\b(?:avoid(?:ing)?|keep|stay|never|not|without)\b", re.I)


def prepare_mission(
    config: Config, task: str | None = None, site: Site = _NO_SITE, **mission: Any
) -> MissionSpec:
    """Prepare a task if there is one, else the mission that `mission` describes.

    Args:
        config: of the service.
        task: instruction in words; None: prepare a mission.
        site: places that a mission may name.
        **mission: arguments of `edge.mission.spec.prepare`.

    Raises:
        UserError: see `prepare_task` and `edge.mission.spec.prepare`.
    """
    if task is not None:
        return prepare_task(config, task)
    instruction = mission.get("instruction")
    if instruction is None:
        instruction = config.mission.instruction
    only_words = not any(mission.get(name) for name in ("formula", "reading", "repeat"))
    is_english = not isinstance(config.mission.translator, TranslatorLtl)
    if instruction is None or not only_words or not is_english:
        return prepare(config.mission, site=site, **mission)
    path_error = None
    try:
        is_path = _is_path(without_manner(f" {instruction}").strip(), site)
    except TranslationError as error:
        is_path, path_error = False, error
    if is_path and says_manner(instruction):
        hint = "how fast it drives is set in the motion controller; leave that out"
        raise unclear(instruction, hint)
    if is_path and _PASSES.search(instruction) and not _BANS.search(instruction):
        return prepare_task(config, instruction)
    try:
        return prepare(config.mission, site=site, **mission)
    except (AmbiguousInstructionError, NoMissionError):
        raise
    except TranslationError as error:
        if is_path:
            return prepare_task(config, instruction)
        rest = instruction[max(error.position - 1, 0) :] or instruction.rpartition(" ")[2]
        # The mission's parser stopped at a word about paths ("go left"), the path's farther on.
        if (
            path_error is not None
            and path_error.position >= error.position
            and not isinstance(error, UnclearError)
            and begins_with_path_word(rest)
        ):
            raise path_error from None
        raise


def _is_path(instruction: str, site: Site) -> bool:
    """Return True if an instruction describes a path past known objects, by its grammar alone.

    A task searches for one object of each name, so a place or a room is none.

    Raises:
        TranslationError: the grammar of paths does not understand it.
    """
    is_path, objects = describes_path(instruction), named_objects(instruction)
    named = [item.name for item in (*site.places, *site.room_names)]
    return (
        is_path
        and not _MORE_THAN_A_PATH.search(instruction)
        and quote_places(instruction, named) == instruction
        and all(nouns.unknown_in(words) is None for words in noun_phrases(instruction))
        and all(names.is_known(name) for name in objects)
    )


def prepare_task(config: Config, task: str) -> MissionSpec:
    """Prepare a task: find the objects that it names, before the robot moves.

    The rules split a task into steps; the objects of a step must be seen before the step is driven.
    A model does the entire task in one step. In that case the detector looks for the known names in
    the instruction, but none of them has to be seen. If the task names no object, the detector
    looks for the target of the configuration.

    Raises:
        TranslationError: the rules do not understand the task; the error names the part.
        MissionError: the task is empty, too long, or names too many objects.
    """
    if not task.strip():
        raise MissionError("task: empty; say where to go")
    if len(task) > MOST_INSTRUCTION_CHARS:
        raise MissionError(
            f"task: {len(task)} characters, the limit is {MOST_INSTRUCTION_CHARS}; shorten it"
        )
    if isinstance(config.tasks.planner, WriterModel):
        steps = (TaskStep(task),)
        targets = known_names(task)[: config.mission.max_targets]
    else:
        steps, targets = task_steps(task), named_objects(task)
    translation = Translation(task, ltl.TRUE, task, config.tasks.planner.kind)
    return spec_of_task(config.mission, translation, targets or (config.mission.target,), steps)


def known_names(text: str) -> tuple[str, ...]:
    """Return the object names in a text that the alias table knows, each object once.

    At each word the longest name wins.

    >>> known_names("Pass the potted plants, then the couch; the sofa is not it.")
    ('potted plant', 'couch')
    """
    words = re.findall(r"[^\W\d_]+", text.lower())
    found: list[str] = []
    at = 0
    while at < len(words):
        ends = range(min(at + _MOST_WORDS, len(words)), at, -1)
        end = next((end for end in ends if names.is_known(" ".join(words[at:end]))), None)
        if end is not None:
            found.append(names.singular(names.normalise(" ".join(words[at:end]))))
        at = at + 1 if end is None else end
    first: dict[str, str] = {}
    for name in found:
        first.setdefault(names.canonical(name), name)
    return tuple(first.values())
