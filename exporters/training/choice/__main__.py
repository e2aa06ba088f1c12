"""Command that trains our small choice model from code, the small detector and a seed.

    python -m exporters.training.choice --out RUN

It lets a robot explore houses (seconds each, stored in RUN/views), reads the images with the
detector's trunk, and trains. A stopped run continues from RUN/checkpoint.pt. The ONNX file is made
and measured in RUN on held-out houses, and put into `--models` with its card.
"""

from __future__ import annotations

import argparse
import logging
import sys

from edge.cli.options import count
from exporters.files import ExportError, exit_on_user_error
from exporters.training.results import training_parser


def seeds(option: str, text: str) -> list[int]:
    """Return the seeds of half-open ranges, in their order; raise ExportError for other text.

    >>> seeds("--houses", "0:3,7:9")
    [0, 1, 2, 7, 8]
    """
    try:
        ends = [part.split(":") for part in text.split(",")]
        ranges = [range(int(first), int(end)) for first, end in ends]
    except ValueError:
        ranges = []
    if not ranges or not all(ranges) or min(r.start for r in ranges) < 0:
        raise ExportError(
            f"{option}: got {text!r}; give ranges such as 0:60 (0 to 59) or 0:10,50:60"
        )
    return [seed for each in ranges for seed in each]


@exit_on_user_error
def main(argv: list[str] | None) -> None:
    """Parse the command line, train, and publish the model."""
    # fmt: off
    parser = training_parser(
        "choice", "train the small model that chooses between frontiers, on generated houses",
        "images and weights",
    )
    option = parser.add_argument
    option("--houses", default="0:130",
           help="seeds of the houses to train on, such as 0:60 for 0 to 59")
    option("--held-out", default="1000:1020",
           help="seeds of the houses to measure on, in the same form")
    option("--steps", type=count, default=1800, help="training steps")
    option("--cores", type=count, default=2, help="number of processes that explore houses")
    # fmt: on
    args = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    _train(args)


def _train(args: argparse.Namespace) -> None:
    """Explore the houses, train, and put the model's file in place."""
    import torch

    from edge.lab.sim.generator.house import HELD_OUT
    from exporters.training.choice import export
    from exporters.training.choice.collect import load_views, make_views
    from exporters.training.choice.features import Trunk, make_features
    from exporters.training.choice.training import Data, TrainingPlan, train

    houses, measured = seeds("--houses", args.houses), seeds("--held-out", args.held_out)
    if max(houses) >= HELD_OUT or min(measured) < HELD_OUT:
        raise ExportError(
            f"--houses, --held-out: got seeds up to {max(houses)} and from {min(measured)}; "
            f"--houses takes seeds below {HELD_OUT}, --held-out the others"
        )
    paths = make_views(houses, args.out / "views", args.cores)
    make_views(measured, args.out / "held-out", args.cores)
    trunk = Trunk(export.DETECTOR_FILE, export.TEXT_FILE)
    views, features = load_views(paths), make_features(paths, trunk)
    logging.info("%d views of %d houses", len(views), len(houses))
    torch.set_num_threads(1)  # more threads do not help with such small tensors
    data = Data(views, features, trunk.level_scales, trunk.words)
    plan = TrainingPlan(seed=args.seed, steps=args.steps)
    train(data, plan, len(trunk.words), args.out / "checkpoint.pt")
    command = (
        f"python -m exporters.training.choice --out RUN --seed {args.seed} --steps {args.steps} "
        f"--houses {args.houses} --held-out {args.held_out}"
    )
    export.put_in_place(args.out, args.models, command, len(houses))


if __name__ == "__main__":
    sys.exit(main())
