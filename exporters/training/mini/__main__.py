"""Command that trains our small detector from code and a seed, and publishes it.

    python -m exporters.training.mini --out RUN

It renders houses (minutes; 8.1 GB, stored in RUN/data) and trains (84 minutes on two cores of an
AMD EPYC; a GPU is used if there is one). A stopped run continues from RUN/checkpoint.pt. The files
are made from the averaged weights and measured in RUN on held-out houses. If they pass the gate,
they are put into `--models`, with cards that have the hashes and the figures.
"""

from __future__ import annotations

import argparse
import logging
import sys
from functools import partial

from edge.cli.options import count
from exporters.files import exit_on_user_error
from exporters.training.results import training_parser

HOUSES, CORES = 3000, 2  # defaults of the options


@exit_on_user_error
def main(argv: list[str] | None) -> None:
    """Parse the command line, train, and publish the model."""
    # fmt: off
    parser = training_parser("mini", "train the small detector on images of random houses",
                             "images and weights, 8.1 GB with the default number of houses")
    option = parser.add_argument
    option("--houses", type=count, default=HOUSES,
           help="number of houses to train on, with 2.7 MB of images each")
    option("--cores", type=count, default=CORES,
           help="number of processes that render, and train without a GPU")
    option("--device", help="device to train on, such as cpu or cuda (default: cuda if there is a "
           "GPU)")
    option("--no-gate", action="store_true",
           help="publish the model even if its scores are below the required ones")
    # fmt: on
    args = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    _train(args)


def _train(args: argparse.Namespace) -> None:
    """Render the images, train, and put the model's files in place."""
    import torch

    from exporters.training import checkpoint as checkpoints
    from exporters.training.mini import export, training, views

    device = args.device or ("cuda" if torch.cuda.is_available() else "cpu")
    plan, checkpoint = training.TrainingPlan(seed=args.seed), args.out / "checkpoint.pt"
    ranks = args.cores if device == "cpu" else 1
    training.check_cores(plan, ranks)
    # Check this before minutes of rendering.
    checkpoints.resume(
        checkpoint, checkpoints.run_identity(plan, args.houses * views.PER_HOUSE, ranks, device)
    )
    houses, data = range(args.houses), args.out / "data"
    make_frames = partial(views.make_frames, houses, views.PER_HOUSE, data, args.cores)
    frames = make_frames()
    logging.info("%d frames, %d objects", len(frames), len(frames.objects))
    if device == "cpu":
        training.train_on_cores(make_frames, plan, checkpoint, ranks)
    else:
        training.train(frames, plan, checkpoint, device)
    # The card holds the command, with the options that are not the defaults.
    usual = {"seed": 0, "houses": HOUSES, "cores": CORES}
    given = {name: getattr(args, name) for name in usual if getattr(args, name) != usual[name]}
    options = "".join(f" --{name} {value}" for name, value in given.items())
    command = f"python -m exporters.training.mini --out RUN{options}"
    export.put_in_place(args.out, args.models, command, gate=not args.no_gate)


if __name__ == "__main__":
    sys.exit(main())
