"""Speed and memory of one direction-choice model, measured in its own process.

`edge.lab.bench.isolated` starts the process.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from edge.errors import UserError
from edge.lab.bench import isolated
from edge.lab.bench.choices import ChoiceJob, ChoiceMeasurement
from edge.lab.bench.service import resident_mb
from edge.perception.scoring.choice.factory import open_choice


def measure(job: ChoiceJob) -> ChoiceMeasurement:
    """Show all views to a model; the time is from the image to both answers."""
    before_mb, began = resident_mb(), time.perf_counter()
    scorer = open_choice(job.choice)
    load_s, took_ms, p = time.perf_counter() - began, [], []
    for view in job.views:
        began = time.perf_counter()
        found = scorer.answer(scorer.prepare(view))
        took_ms.append((time.perf_counter() - began) * 1e3)
        if found is None:  # no letter fits, so the image cannot be used for a comparison
            raise UserError(
                f"image {view.observation.seq}: too small for the letters that mark the "
                "frontiers; use larger --images"
            )
        p.append([*found.p, found.elsewhere, found.scene])
    memory_mb = resident_mb() - before_mb
    return ChoiceMeasurement(np.array(took_ms), np.array(p, np.float32), load_s, memory_mb)


if __name__ == "__main__":
    sys.exit(isolated.main(sys.argv[1:], measure))
