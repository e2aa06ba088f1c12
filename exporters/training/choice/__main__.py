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


@exit_on_user_error
def main(argv: list[str] | None) -> None:
    """Parse the command line, train, and publish the model."""
    # fmt: off
    parser = training_parser(
        "choice", "train the small model that chooses between frontiers, on generated houses",
        "images and weights",
    )
    option = parser.add_argument
    option("--houses", type=count, default=130, help="number of houses to train on")
    option("--held-out", type=count, default=20, help="number of other houses to measure on")
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

    if args.houses > HELD_OUT:
        raise ExportError(
            f"--houses: got {args.houses}; give at most {HELD_OUT}, since houses with higher seeds "
            "are held out"
        )
    paths = make_views(range(args.houses), args.out / "views", args.cores)
    held_out = range(HELD_OUT, HELD_OUT + args.held_out)
    make_views(held_out, args.out / "held-out", args.cores)
    trunk = Trunk(export.DETECTOR_FILE, export.TEXT_FILE)
    views, features = load_views(paths), make_features(paths, trunk)
    logging.info("%d views of %d houses", len(views), args.houses)
    torch.set_num_threads(1)  # more threads do not help with such small tensors
    data = Data(views, features, trunk.level_scales, trunk.words)
    plan = TrainingPlan(seed=args.seed, steps=args.steps)
    train(data, plan, len(trunk.words), args.out / "checkpoint.pt")
    command = (
        f"python -m exporters.training.choice --out RUN --seed {args.seed} --steps {args.steps} "
        f"--houses {args.houses} --held-out {args.held_out}"
    )
    export.put_in_place(args.out, args.models, command, args.houses)


if __name__ == "__main__":
    sys.exit(main())
