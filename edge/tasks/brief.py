"""From a task in words to a mission that can be run, or to one line that says why not."""

from __future__ import annotations

import re

from edge import names
from edge.config import Config, WriterModel
from edge.memory import Site
from edge.mission.brief import Brief, MissionError, brief_of_task, prepare
from edge.mission.logic import ltl
from edge.mission.task_step import TaskStep
from edge.mission.translate import Translation
from edge.tasks.prompt import MOST_INSTRUCTION_CHARS
from edge.tasks.reading import named, task_steps

_NO_SITE = Site()
_MOST_WORDS = 4
"""Of a name that is looked for in an instruction."""


def prepared(
    config: Config, task: str | None = None, site: Site = _NO_SITE, **mission: str | int | None
) -> Brief:
    """A task, or else a mission as `edge.mission.brief.prepare` makes it.

    Raises:
        UserError: see `prepare_task` and `edge.mission.brief.prepare`.
    """
    if task is not None:
        return prepare_task(config, task)
    return prepare(config.mission, site=site, **mission)


def prepare_task(config: Config, task: str) -> Brief:
    """Find out what a task names, before anything moves.

    With the rules, what a step names has to be seen before it is driven. A model may do without,
    and does the whole in one step: words of the instruction that are names of things are looked
    for, and none has to be seen. Where there is nothing to look for, the detector looks for the
    configuration's own target.

    Raises:
        TranslationError: the rules do not understand it; it names the part.
        MissionError: it is empty, too long, or names too much.
    """
    if not task.strip():
        raise MissionError("task: it is empty; say where to go")
    if len(task) > MOST_INSTRUCTION_CHARS:
        raise MissionError(
            f"task: it has {len(task)} characters, at most {MOST_INSTRUCTION_CHARS} are taken"
        )
    if isinstance(config.tasks.planner, WriterModel):
        steps = (TaskStep(task),)
        targets = known_names(task)[: config.mission.max_targets]
    else:
        steps, targets = task_steps(task), named(task)
    translation = Translation(task, ltl.TRUE, task, config.tasks.planner.kind)
    return brief_of_task(config.mission, translation, targets or (config.mission.target,), steps)


def known_names(text: str) -> tuple[str, ...]:
    """Names of things in a text that the alias table has, the longest first at each word; each
    thing once.

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
