"""File with the tasks of `edge eval planning`, one JSON line each (`FIELDS`)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from edge import names
from edge.errors import UserError
from edge.host.files import read_regular, save
from edge.lab.eval.planning.delexicalised import (
    MAX_OBJECTS,
    delexicalise,
    with_canonical_names,
    world_of,
)
from edge.lab.eval.planning.templates import BenchmarkTask
from edge.mission.logic.ltl import parse, propositions, to_text
from edge.text import bounded_repr, read_json_object

# Fields of a line, with their types. `template` is the name of the template's family.
FIELDS = {"id": int, "template": str, "objects": list, "sentence": str, "formula": str}


class TaskFileError(UserError):
    """A file of tasks that cannot be used; the message has the line and the problem."""


def write_tasks(path: Path, tasks: Sequence[BenchmarkTask]) -> None:
    """Replace `path` with the tasks, one a line.

    Raises:
        FileError: the file cannot be written.
    """
    lines = [
        json.dumps(
            {
                "id": task.id,
                "template": task.family,
                "objects": list(task.objects),
                "sentence": task.sentence,
                "formula": to_text(task.formula),
            }
        )
        for task in tasks
    ]
    save(path, ("\n".join(lines) + "\n").encode())


def read_tasks(path: Path) -> list[BenchmarkTask]:
    """Read tasks in the format of `write_tasks`. Objects may have any name that `edge.names` knows.

    Raises:
        TaskFileError: the file cannot be read, or a line is not a task that can be fulfilled.
    """
    try:
        lines = read_regular(path).decode("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise TaskFileError(f"{path}: cannot be read: {reason}") from None
    tasks: dict[int, BenchmarkTask] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            task = _parse_task(line)
            if task.id in tasks:
                raise ValueError(
                    f"id: {task.id} is also the id of an earlier line; ids must differ"
                )
        except (ValueError, UserError) as error:
            raise TaskFileError(f"{path}: line {number}: {error}") from None
        tasks[task.id] = task
    if not tasks:
        raise TaskFileError(
            f"{path}: the file has no tasks; `edge eval planning --export {path}` writes some"
        )
    return list(tasks.values())


def _parse_task(line: str) -> BenchmarkTask:
    """Parse a task."""
    try:
        data = read_json_object(line)
    except ValueError as error:
        raise ValueError(
            f"{error}; each line must be one task with the fields {', '.join(FIELDS)}"
        ) from None
    for field, kind in FIELDS.items():
        if not isinstance(data.get(field), kind) or isinstance(data[field], bool):
            raise ValueError(
                f"{field}: expected {kind.__name__}, got {bounded_repr(data.get(field), 60)}"
            )
    if not 0 <= data["id"] < 1 << 63:
        raise ValueError(f"id: expected 0 to 2**63 - 1, got {data['id']}")
    formula = with_canonical_names(parse(data["formula"]))
    objects = propositions(formula)
    if {names.canonical(str(name)) for name in data["objects"]} != set(objects):
        raise ValueError(f"objects: expected the objects of the formula: {', '.join(objects)}")
    if len(world_of(objects)) > MAX_OBJECTS:
        raise ValueError(
            f"objects: {len(world_of(objects))} with the six of HM3D, which are always added; at "
            f"most {MAX_OBJECTS} are allowed"
        )
    if delexicalise(formula).automaton.steps_left[0] < 0:
        raise ValueError("formula: contradicts itself, so no mission can fulfil it")
    return BenchmarkTask(data["id"], data["template"], objects, data["sentence"], formula)
