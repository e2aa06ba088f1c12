"""The folder with the results of one run of `edge trajectory`."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np

from edge.config import WriterModel
from edge.errors import FileError
from edge.host.files import make_writable, save
from edge.lab.eval.trial.task_run import TaskRun, ground_heights_m
from edge.lab.report import camera_picture, trajectory_map
from edge.lab.report.recorder import machine
from edge.lab.report.view3d import Line, coarse_and_refined, scene_page
from edge.tasks.prompt import annotated_jpeg, system_prompt, task_text
from edge.tasks.scene.picture import draw_marks
from edge.text import one_line

# Names of the files; MODEL is a folder with what a model got and answered.
OBJECTS, CAMERA, MAP, PAGE = "objects.png", "camera.png", "map.png", "scene.html"
JSON, CSV, MODEL = "trajectory.json", "trajectory.csv", "model"
# Of the CSV file; the first four are those of `RefinedTrajectory.poses`.
COLUMNS = ("x_m", "y_m", "z_m", "heading_rad", "speed_mps", "time_s")


class RunFolder:
    """Writes the results of `edge trajectory` as files of a folder.

    Attributes:
        written: names of the files, in the order of writing.

    Raises:
        FileError: the folder cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.written = path, list[str]()
        try:
            make_writable(path)
            # Files of an earlier run would look like results of this one.
            old = [path / name for name in (OBJECTS, CAMERA, MAP, PAGE, JSON, CSV)]
            for file in (*old, *(path / MODEL).glob("*.*")):
                file.unlink(missing_ok=True)
        except OSError as error:
            raise FileError(
                f"--out {path}: cannot be written: {error.strerror}; choose another folder"
            ) from None

    def save(self, outcome: TaskRun) -> None:
        """Write all results that there are."""
        view, refined, scene = outcome.view, outcome.refined, outcome.view.scene
        self._write_picture(OBJECTS, draw_marks(scene))
        coarse_m = outcome.coarse_m
        coarse_on_ground_m = None
        if coarse_m is not None:
            coarse_on_ground_m = np.column_stack([coarse_m, ground_heights_m(view, coarse_m)])
            refined_m = None if refined is None else refined.poses[:, :3]  # x, y, z
            half_m = outcome.config.robot.radius_m
            self._write_picture(
                CAMERA, camera_picture.draw_trajectory(scene, coarse_on_ground_m, refined_m, half_m)
            )
        self._write(MAP, trajectory_map.png(scene, coarse_m, refined, outcome.costmap))
        self._write(PAGE, _bytes(_page(outcome, coarse_on_ground_m)))
        if refined is not None:
            text = json.dumps(as_json(outcome), indent=1, ensure_ascii=False)
            self._write(JSON, _bytes(text))
            self._write(CSV, _csv(outcome).encode())
        if isinstance(outcome.config.tasks.planner, WriterModel):
            for name, content in _model_files(outcome).items():
                self._write(f"{MODEL}/{name}", content)

    def _write_picture(self, name: str, rgb: np.ndarray | None) -> None:
        if rgb is not None:
            ok, png = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
            assert ok, name
            self._write(name, png.tobytes())

    def _write(self, name: str, content: bytes) -> None:
        save(self.path / name, content)
        self.written.append(name)


def as_json(outcome: TaskRun) -> dict[str, object]:
    """Return the trajectory and its origin, JSON-ready.

    Lengths are in metres, angles in radians, times in seconds, all in the frame `map`.
    """
    written, refined = outcome.written, outcome.refined
    assert written is not None
    assert refined is not None
    return {
        "instruction": outcome.instruction,
        "place": outcome.view.name,
        "frame": "map",
        "understood": written.understood,
        "objects": [obj.id for obj in outcome.mentioned_objects()],
        "coarse": [_rounded(points) for points in written.coarse.segments],
        "regions": sorted(refined.drivable),
        "length_m": round(outcome.length_m, 3),
        "poses": _rounded(refined.poses),
        "speeds_mps": _rounded(refined.speeds_mps),
        "times_s": _rounded(refined.times_s),
        "notes": list(refined.notes),
    }


def _csv(outcome: TaskRun) -> str:
    refined, out = outcome.refined, io.StringIO()
    assert refined is not None
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(COLUMNS)
    rows.writerows(_rounded(np.column_stack([refined.poses, refined.speeds_mps, refined.times_s])))
    return out.getvalue()


def _page(outcome: TaskRun, coarse_on_ground_m: np.ndarray | None) -> str:
    view, refined = outcome.view, outcome.refined
    lines: tuple[Line, ...] = ()
    if coarse_on_ground_m is not None and refined is not None:
        lines = coarse_and_refined(coarse_on_ground_m, refined)
    elif coarse_on_ground_m is not None:
        lines = (Line("as it was written", coarse_on_ground_m, trajectory_map.COARSE, 2.0),)
    facts = [("place", view.name), ("objects from", view.by)]
    if outcome.written is not None and outcome.written.understood:
        facts.append(("understood", outcome.written.understood))
    if refined is not None:
        facts.append(("length", f"{outcome.length_m:.1f} m in {refined.times_s[-1]:.1f} s"))
        facts += [("note", note) for note in refined.notes]
    if outcome.error:
        facts.append(("refused", outcome.error))
    return scene_page(
        one_line(outcome.instruction, 120), view.scene, lines, machine(), refined=refined,
        cloud_m=view.cloud_m, facts=facts, ground_m=view.base_z_m,
    )  # fmt: skip


def _model_files(outcome: TaskRun) -> dict[str, bytes]:
    """Return the prompt and picture for the model, and each answer of the model, by file name."""
    tasks, scene = outcome.config.tasks, outcome.view.scene
    assert isinstance(tasks.planner, WriterModel)
    question = task_text(outcome.instruction, scene, tasks.trajectory)
    files = {"prompt.txt": _bytes(f"{system_prompt()}\n\n{question}\n")}
    jpeg = annotated_jpeg(scene) if tasks.planner.picture else None
    if jpeg is not None:
        files["picture.jpg"] = jpeg
    for k, attempt in enumerate(outcome.rounds, start=1):
        kinds = {"answer": "txt", "code": "py", "printed": "txt", "error": "txt"}
        for name, text in asdict(attempt).items():
            if text:
                files[f"round-{k}-{name}.{kinds[name]}"] = _bytes(text)
    return files


def _bytes(text: str) -> bytes:
    """Encode a text that may hold invalid characters: a model's answer, a command line."""
    return text.encode("utf-8", errors="replace")


def _rounded(values: np.ndarray) -> list:
    return np.round(values, 4).tolist()
