"""Train the small detector of our own, from nothing but code and a seed.

    python -m exporters.train_mini --out DIR

Renders houses (minutes; 8.1 GB, kept in DIR/data) and trains (84 minutes on two cores of an AMD
EPYC; a GPU is used where there is one); goes on from DIR/checkpoint.pt when stopped. Then
`python -m exporters.mini.export DIR` makes the ONNX files of the averaged weights.
"""

from __future__ import annotations

import argparse
import logging
import sys
from functools import partial
from pathlib import Path

from exporters.files import ExportError, tells_errors

SEED, HOUSES, CORES = 0, 3000, 2
PER_HOUSE = 11
"""Pictures of each house."""


@tells_errors
def main(argv: list[str] | None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m exporters.train_mini",
        description="train the small detector on pictures of random houses",
    )
    parser.add_argument(
        "--out", type=Path, required=True,
        help="folder of data and weights; the usual houses' pictures take 8.1 GB",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument(
        "--houses", type=int, default=HOUSES,
        help="how many to train on; 2.7 MB of pictures each (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--cores", type=int, default=CORES,
        help="processes that render, and that train where there is no GPU (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--device", help="cpu, cuda, … (default: cuda when there is one)")
    args = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    _train(args)


def _train(args: argparse.Namespace) -> None:
    import torch

    from exporters.mini import checkpoint as checkpoints
    from exporters.mini import training, views

    device = args.device or ("cuda" if torch.cuda.is_available() else "cpu")
    plan, checkpoint = training.Plan(seed=args.seed), args.out / "checkpoint.pt"
    ranks = args.cores if device == "cpu" else 1
    for option in ("houses", "cores"):
        if getattr(args, option) < 1:
            raise ExportError(f"--{option} {getattr(args, option)}: give at least 1")
    training.check_cores(plan, ranks)
    # Before minutes of rendering.
    checkpoints.resume(
        checkpoint, checkpoints.describe(plan, args.houses * PER_HOUSE, ranks, device)
    )
    houses, data = range(args.houses), args.out / "data"
    make = partial(views.make_frames, houses, PER_HOUSE, data, args.cores)
    frames = make()
    logging.info("%d frames, %d things", len(frames), len(frames.objects))
    if device == "cpu":
        training.train_on_cores(make, plan, checkpoint, ranks)
    else:
        training.train(frames, plan, checkpoint, device)
    logging.info("done: %s", checkpoint)


if __name__ == "__main__":
    sys.exit(main())
