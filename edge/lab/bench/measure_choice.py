"""Speed and memory of one choice model (VLM frontier selection), measured in its own process.

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
from edge.perception.scoring.choice.factory import open_view_scorer


def measure(job: ChoiceJob) -> ChoiceMeasurement:
    """Ask a model about all views; measure the time to load it and the time per view.

    The time per view includes preparing the image and all answers of the model: the probability
    of each mark, of "elsewhere", and the answer to the scene question.
    """
    before_mb, began = resident_mb(), time.perf_counter()
    scorer = open_view_scorer(job.choice)
    load_s, took_ms, rows = time.perf_counter() - began, [], []
    for view in job.views:
        began = time.perf_counter()
        found = scorer.answer(scorer.prepare(view))
        took_ms.append((time.perf_counter() - began) * 1e3)
        if found is None:  # no mark fits into the image, so it cannot be compared
            raise UserError(
                f"image {view.observation.seq}: too small for the letters that mark the "
                "frontiers; use larger --images"
            )
        rows.append([*found.p, found.elsewhere, found.scene])  # see `ChoiceMeasurement.p`
    memory_mb = resident_mb() - before_mb
    return ChoiceMeasurement(np.array(took_ms), np.array(rows, np.float32), load_s, memory_mb)


if __name__ == "__main__":
    sys.exit(isolated.main(sys.argv[1:], measure))
