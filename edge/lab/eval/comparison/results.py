"""`edge eval results`: a document of measurements, made whole by one command.

A YAML file says what belongs into it, section by section. What has not been run is run, and the
Markdown is written next to the outcomes. It names no date, so it changes only when a result does.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, field_validator, model_validator

import edge
from edge.config import ConfigError, Section
from edge.config.explain import explain_all
from edge.config.yaml_text import read_yaml
from edge.errors import FileError, UserError
from edge.host.children import python_module
from edge.host.files import write_atomically
from edge.lab.eval.comparison import outcomes as records
from edge.lab.eval.comparison import plots, tables
from edge.lab.eval.comparison.run import compare_folders
from edge.lab.eval.comparison.statistics import Comparison
from edge.lab.eval.comparison.tables import TABLES, Shown
from edge.lab.eval.outcome import NAME as OUTCOMES_NAME
from edge.lab.eval.trajectories import chapter as trajectory_chapter
from edge.lab.eval.trajectories import tables as trajectory_tables
from edge.lab.report.recorder import machine


class Chapter(Section):
    """A section of the document.

    Attributes:
        name: of its folder of outcomes, and of its images.
        text: Markdown that stands above its tables.
        episodes: words after `edge eval episodes`, a run each: configuration, worlds, targets.
        columns: by name, what is changed in the configuration, as `--column` has it.
        trajectories: words after `edge eval trajectories`, a run each; with these it has no
            columns, and tables and plots of its own.
        of: other sections, whose outcomes it is made of; then it runs nothing itself.
        show: the only columns to show, its own or those that `of` has; none: all.
        baseline: the column that the others are held against; None: the first.
        tables: which, in their order; None: those that are commonly wanted.
        plots: which, in their order.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
    title: str
    text: str = ""
    episodes: tuple[str, ...] = ()
    columns: dict[str, dict[str, Any]] = Field(default_factory=dict)
    trajectories: tuple[str, ...] = ()
    of: tuple[str, ...] = ()
    show: tuple[str, ...] = ()
    baseline: str | None = None
    tables: tuple[str, ...] | None = None
    plots: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _of_one_kind(self) -> Chapter:
        there, drawn = TABLES, tuple(plots.PLOTS)
        if self.trajectories:
            there, drawn = trajectory_tables.NAMES, trajectory_chapter.PLOTS
            for name in ("columns", "show", "baseline"):
                if getattr(self, name):
                    raise ValueError(f"{self.name}: trajectories have no {name!r}")
        for names, choices in ((self.tables or (), there), (self.plots, drawn)):
            for name in names:
                if name not in choices:
                    raise ValueError(f"unknown {name!r} (choices: {', '.join(choices)})")
        return self

    @property
    def shown_tables(self) -> tuple[str, ...]:
        if self.tables is not None:
            return self.tables
        return trajectory_tables.NAMES if self.trajectories else ("summary", "paired", "failures")


class Book(Section):
    """A document: what stands at its head, and its sections in their order."""

    title: str = "Results"
    text: str = ""
    sections: tuple[Chapter, ...]

    @field_validator("sections")
    @classmethod
    def _whole(cls, sections: tuple[Chapter, ...]) -> tuple[Chapter, ...]:
        running = [chapter.name for chapter in sections if chapter.episodes]
        for k, chapter in enumerate(sections):
            if chapter.name in [other.name for other in sections[:k]]:
                raise ValueError(f"{chapter.name}: there are two of that name")
            if sum(map(bool, (chapter.episodes, chapter.trajectories, chapter.of))) != 1:
                raise ValueError(
                    f"{chapter.name}: give it either `episodes`, `trajectories` or `of`"
                )
            for other in chapter.of:
                if other not in running:
                    raise ValueError(f"{chapter.name}: of: no section {other!r} runs episodes")
            _check_columns(chapter, columns_of(chapter, sections))
        return sections


def columns_of(chapter: Chapter, sections: Sequence[Chapter]) -> tuple[str, ...]:
    """The columns that a section is to show, in their order; none: whatever there is."""
    named = [s for s in sections if s.name in chapter.of] if chapter.of else [chapter]
    return chapter.show or tuple(dict.fromkeys(name for s in named for name in s.columns))


def _check_columns(chapter: Chapter, shown: tuple[str, ...]) -> None:
    if shown and chapter.baseline is not None and chapter.baseline not in shown:
        raise ValueError(
            f"{chapter.name}: baseline: {chapter.baseline!r} is no column that it shows"
        )


def read(path: Path) -> Book:
    """
    Raises:
        ConfigError: it cannot be read, or is no such file; one line a fault.
    """
    data = read_yaml(path)
    try:
        return Book.model_validate(data)
    except ValidationError as error:
        raise ConfigError(explain_all(error, str(path), Book)) from None


def run(args: argparse.Namespace) -> int:
    """Handle `edge eval results`.

    Raises:
        UserError: the file is not right; a run failed; something cannot be read or written.
    """
    book = read(args.file)
    for chapter in chosen(book, args.only):
        if not args.no_run:
            _run_chapter(chapter, args)
    found = {
        chapter.name: shown
        for chapter in book.sections
        if (shown := _shown(chapter, book, args.out)) is not None
    }
    path = args.out / f"{args.file.stem}.md"
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        images = _write_plots(found, args.out)
        write_atomically(path, document(book, found, args.file, args.out, machine()).encode())
    except OSError as error:
        raise FileError(f"{path}: {error.strerror or error}") from None
    print("\n".join(map(str, [path, *images])))
    return 0


def chosen(book: Book, only: Sequence[str] | None) -> list[Chapter]:
    """The sections to run: all, or those named and what they are made of.

    Raises:
        UserError: there is no such section.
    """
    there = {chapter.name: chapter for chapter in book.sections}
    if only is None:
        return list(book.sections)
    for name in only:
        if name not in there:
            raise UserError(f"--only: no section {name!r}; there are: {', '.join(there)}")
    wanted = {part for name in only for part in (name, *there[name].of)}
    return [chapter for chapter in book.sections if chapter.name in wanted]


def _run_chapter(chapter: Chapter, args: argparse.Namespace) -> None:
    """What has an outcome already is not run again: the commands see to that."""
    options = ["--workers", str(args.workers)] if chapter.episodes else []
    if args.episodes is not None:
        options += ["--limit", str(args.episodes)]
    for words in commands(chapter, args.out):
        print(f"edge {shlex.join([*words, *options])}", flush=True)
        code = subprocess.run(
            [*python_module("edge.cli"), *words, *options], check=False
        ).returncode
        if code:
            command = f"edge {' '.join(words[:2])}"
            raise UserError(f"{chapter.name}: `{command}` ended with {code}; it says why above")


def commands(chapter: Chapter, out: Path) -> list[list[str]]:
    """The words after `edge`, a list a run, that make a section's outcomes."""
    columns: list[str] = []
    for column, settings in chapter.columns.items():
        columns += ["--column", column, *_settings(settings)]
    runs = [["episodes", *shlex.split(words), *columns] for words in chapter.episodes]
    runs += [["trajectories", *shlex.split(words)] for words in chapter.trajectories]
    return [["eval", *words, "--out", str(out / chapter.name)] for words in runs]


def _settings(settings: Mapping[str, Any], above: str = "") -> list[str]:
    """`policy.kind=search` for each leaf of nested settings."""
    found: list[str] = []
    for key, value in settings.items():
        if isinstance(value, Mapping) and value:
            found += _settings(value, f"{above}{key}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value)
            found.append(f"{above}{key}={text}")
    return found


def _shown(chapter: Chapter, book: Book, out: Path) -> Shown | None:
    """What a section's outcomes say; None where it has none, or lacks its baseline's."""
    if chapter.trajectories:
        return trajectory_chapter.shown(out / chapter.name, chapter.shown_tables, chapter.plots)
    folders = [out / name for name in chapter.of or (chapter.name,)]
    if not all((folder / OUTCOMES_NAME).exists() for folder in folders):
        return None
    ran = {r["column"] for folder in folders for r in records.read(folder / OUTCOMES_NAME)}
    wanted = columns_of(chapter, book.sections) or tuple(sorted(ran))
    there = [name for name in wanted if name in ran]
    if not there or (chapter.baseline or there[0]) not in there:
        return None
    comparison = compare_folders(folders, chapter.baseline, there)[0]
    return of_comparison(chapter, comparison, columns_of(chapter, book.sections))


def of_comparison(chapter: Chapter, comparison: Comparison, wanted: Sequence[str]) -> Shown:
    """What a section shows of a comparison.

    Args:
        wanted: the columns that it is to have.
    """
    there = {table.name: table for table in tables.tables(comparison)}
    return Shown(
        _counted(comparison, wanted),
        [there[name] for name in chapter.shown_tables if name in there],
        {
            name: (plots.PLOTS[name][1], content)
            for name, content in plots.images(comparison, "png", chapter.plots).items()
        },
    )


def _write_plots(found: Mapping[str, Shown], folder: Path) -> list[Path]:
    paths = []
    for name, shown in found.items():
        for plot, (_, content) in shown.images.items():
            paths.append(folder / f"{name}-{plot}.png")
            write_atomically(paths[-1], content)
    return paths


# -- the document -------------------------------------------------------------------------------


def document(book: Book, found: Mapping[str, Shown], path: Path, out: Path, computer: str) -> str:
    """Write the Markdown.

    Args:
        found: by section; of one that is not there it says that it was not run.
        path: of the YAML.
        out: where outcomes are.
        computer: in words.
    """
    parts = [
        f"# {book.title}",
        book.text.strip(),
        f"Made by `edge eval results {path}` with edge {edge.__version__} on {computer}. "
        "SR: success rate; SPL: success weighted by path length (Anderson et al. 2018); soft SPL: "
        "progress in place of success (Datta et al. 2020). Every column of a table drove the same "
        "episodes, but where it says which ran fewer.",
    ]
    for chapter in book.sections:
        parts += _chapter(chapter, found.get(chapter.name), out)
    return "\n\n".join(part for part in parts if part) + "\n"


def _chapter(chapter: Chapter, shown: Shown | None, out: Path) -> list[str]:
    parts = [f"## {chapter.title}", chapter.text.strip()]
    lines = [f"edge {shlex.join(words)}" for words in commands(chapter, out)]
    if lines:
        parts.append("\n".join(["```sh", *lines, "```"]))
    if shown is None:
        return [*parts, "Not run yet."]
    parts.append(shown.words)
    for table in shown.tables:
        parts += [f"**{table.title}**", tables.markdown(table)]
    for plot, (words, _) in shown.images.items():
        parts.append(f"![{words}]({chapter.name}-{plot}.png)")
    return parts


def _counted(comparison: Comparison, shown: Sequence[str]) -> str:
    """How many episodes; of which columns fewer, and of which none."""
    outcomes = comparison.outcomes
    n, worlds = len(outcomes.episodes), len(set(outcomes.world.tolist()))
    text = f"{n} episode{'s' * (n != 1)} in {worlds} world{'s' * (worlds != 1)}."
    short = [
        f"{name} {ran}"
        for name, ran in zip(outcomes.columns, outcomes.ran.sum(axis=1).tolist(), strict=True)
        if ran < n
    ]
    text += f" Of these ran fewer: {', '.join(short)}." if short else ""
    none = [name for name in shown if name not in outcomes.columns]
    return f"{text} Not run yet: {', '.join(none)}." if none else text
