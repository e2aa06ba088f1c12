"""What a folder of outcomes says, for a document of results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from edge.lab.eval.comparison.tables import Shown
from edge.lab.eval.trajectories import pictures, tables
from edge.lab.eval.trajectories.outcomes import Folder, Results, gather

PLOTS = ("episodes",)


def shown(folder: Path, wanted: Sequence[str], plots: Sequence[str]) -> Shown | None:
    """The tables and plots wanted, in this order; None where nothing has been run.

    Raises:
        FileError, UserError: what is there cannot be read, or is something else.
    """
    if not folder.is_dir():
        return None
    kept = Folder(folder)
    if not kept.outcomes:
        return None
    results = gather(kept.facts.values(), kept.outcomes.values())
    there = {table.name: table for table in tables.tables(results)}
    drawn = pictures.images(results, "png") if plots else {}
    return Shown(
        _counted(results),
        [there[name] for name in wanted if name in there],
        {name: (pictures.WORDS[name], drawn[name]) for name in plots if name in drawn},
    )


def _counted(results: Results) -> str:
    n, places = len(results.facts), len({facts.world for facts in results.facts})
    text = f"{n} episode{'s' * (n != 1)} in {places} place{'s' * (places != 1)}."
    short = [
        f"{name} {ran}"
        for name, ran in zip(results.methods, results.ran.sum(axis=1).tolist(), strict=True)
        if ran < n
    ]
    return f"{text} Of these ran fewer: {', '.join(short)}." if short else text
