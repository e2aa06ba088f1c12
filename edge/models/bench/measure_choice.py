"""One choosing model alone in a process: `python -m edge.models.bench.measure_choice JOB OUT`, both
pickled."""

from __future__ import annotations

import pickle
import sys
import time
from pathlib import Path

import numpy as np

from edge.errors import UserError
from edge.eval.bench import resident_mb
from edge.logs import setup
from edge.models.bench.choices import Job, Measured
from edge.perception.choice.onnx_scorer import OnnxChoice, open_model
from edge.text import one_line


def main(argv: list[str]) -> int:
    """Do what the job says; 0, or 1 with one line on stdout."""
    setup("error")
    job, out = map(Path, argv)
    try:
        out.write_bytes(pickle.dumps(measure(pickle.loads(job.read_bytes()))))
    except UserError as error:
        print(one_line(error, 1000))
        return 1
    return 0


def measure(job: Job) -> Measured:
    """Ask a model about all views; the time is that of both questions."""
    before_mb, began = resident_mb(), time.perf_counter()
    choice = job.choice
    scorer = OnnxChoice(open_model(choice), choice.max_image_px, choice.time_limit_s)
    load_s, took_ms, p = time.perf_counter() - began, [], []
    for view in job.views:
        shown = scorer.look(view)
        began = time.perf_counter()
        found = scorer.answer(shown)
        took_ms.append((time.perf_counter() - began) * 1e3)
        if found is None:  # no room for a letter: no picture to compare models on
            raise UserError(f"view {view.observation.seq}: no room for letters in the picture")
        p.append([*found.p, found.elsewhere, found.scene])
    memory_mb = resident_mb() - before_mb
    return Measured(np.array(took_ms), np.array(p, np.float32), load_s, memory_mb)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
