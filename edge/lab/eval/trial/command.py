"""The command `edge trajectory`: writes the results of one instruction, and prints a table."""

from __future__ import annotations

import argparse
import os
import re

from edge.chat import make_chat_client
from edge.config import Config, WriterModel, load
from edge.host import resources
from edge.lab.eval.trial.files import RunFolder
from edge.lab.eval.trial.scene_capture import (
    SceneCapture,
    SceneCaptureError,
    capture_kitti,
    capture_street,
)
from edge.lab.eval.trial.task_run import TaskRun, run_task
from edge.tasks.mission_spec import known_names
from edge.tasks.sentences.reading import named_objects
from edge.tasks.write import check_instruction
from edge.text import format_table, one_line

_STREET = re.compile(r"street:(\d{1,9})")


def run(args: argparse.Namespace) -> int:
    """Carry out the instruction, write the files, and print a table.

    Raises:
        UserError: an option is wrong, or there is no trajectory that can be driven; the folder has
            the results so far.
    """
    check_instruction(args.instruction)
    config = _config(args)
    words = _words(args.instruction, config) if args.objects == "detector" else None
    folder = RunFolder(resources.expand(args.out))
    outcome, failed = run_task(args.instruction, _view(args, config, words), config)
    folder.save(outcome)
    print(format_table(table(outcome, folder)))
    if failed is not None:
        raise failed
    return os.EX_OK


def table(outcome: TaskRun, folder: RunFolder) -> list[tuple[str, str]]:
    """Return the result as rows of a name and a value."""
    view, refined = outcome.view, outcome.refined
    scene, rows = view.scene, [("place", one_line(view.name))]
    seen = f"{len(scene.objects)} objects from {view.by}, {len(scene.regions)} regions of ground"
    rows.append(("seen", seen))
    if outcome.written is not None:
        by_model = f"by a model, in {len(outcome.rounds)} answers"
        rows.append(("written", one_line(outcome.written.understood or by_model)))
    rows += [
        ("object", f"{obj.id}: {one_line(obj.caption, 90)}") for obj in outcome.mentioned_objects()
    ]
    if refined is not None:
        shape = f"spline of {refined.control_m:g} m" if refined.control_m else "not smoothed"
        took = f"{outcome.length_m:.1f} m in {refined.times_s[-1]:.1f} s"
        rows.append(("trajectory", f"{took}, {len(refined.poses)} poses, {shape}"))
        rows += [("note", note) for note in refined.notes]
    if (near := outcome.object_at_end()) is not None:
        rows.append(("ends", f"{near[1]:.1f} m from {near[0].label} {near[0].id}"))
    return [*rows, ("files", f"{folder.path}: {', '.join(folder.written)}")]


def _view(args: argparse.Namespace, config: Config, words: tuple[str, ...] | None) -> SceneCapture:
    seed = _STREET.fullmatch(args.place)
    if seed is None and args.place.startswith("street:"):
        raise SceneCaptureError(
            f"PLACE: {one_line(args.place)}: expected street:N with a number N, such as street:3"
        )
    if seed is None:
        return capture_kitti(resources.expand(args.place), args.frames, config, words)
    if args.frames:
        raise SceneCaptureError(
            f"--frames: {args.place} has no frames; omit --frames, or give a folder as PLACE"
        )
    return capture_street(int(seed[1]), config, words)


def _words(instruction: str, config: Config) -> tuple[str, ...]:
    """Return the words that the detector looks for.

    For the rules, these are the objects that they find in the instruction; for a model, all known
    names of objects.
    """
    if not isinstance(config.tasks.planner, WriterModel):
        return named_objects(instruction)
    return known_names(instruction)


def _config(args: argparse.Namespace) -> Config:
    """Return the configuration with `--url` and `--model` applied."""
    config = load(args.config)
    planner = config.tasks.planner
    changes = {key: value for key in ("url", "model") if (value := getattr(args, key)) is not None}
    if changes:
        model = planner if isinstance(planner, WriterModel) else WriterModel()
        planner = model.model_copy(update=changes)
        tasks = config.tasks.model_copy(update={"planner": planner})
        config = config.model_copy(update={"tasks": tasks})
    if isinstance(planner, WriterModel):
        make_chat_client(planner).close()  # reports an invalid URL or key before the work
    return config
