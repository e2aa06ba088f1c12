"""Train the small choice scorer of our own, from nothing but code, the small detector and a seed.

    python -m exporters.train_choice --out DIR

Has a robot explore houses (seconds each, kept in DIR/views), reads what it saw with the detector's
trunk, and trains; goes on from DIR/checkpoint.pt when stopped. Then
`python -m exporters.choice.export DIR` makes the ONNX file and its card.
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from exporters.files import ExportError, tells_errors

SEED, HOUSES, HELD_OUT_HOUSES, CORES = 0, 60, 20, 2


@tells_errors
def main(argv: list[str] | None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m exporters.train_choice",
        description="train the small choice scorer on what a robot sees in generated houses",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of views and weights")
    parser.add_argument("--seed", type=int, default=SEED, help="of the training; default: 0")
    parser.add_argument(
        "--houses", type=int, default=HOUSES, help="how many to train on (default: %(default)s)"
    )
    parser.add_argument(
        "--held-out", type=int, default=HELD_OUT_HOUSES,
        help="how many more to measure on (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--cores", type=int, default=CORES, help="processes that explore")
    args = parser.parse_args(argv)
    for option in ("houses", "held_out", "cores"):
        if getattr(args, option) < 1:
            named = option.replace("_", "-")
            raise ExportError(f"--{named} {getattr(args, option)}: give at least 1")
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    _train(args)


def _train(args: argparse.Namespace) -> None:
    import torch
    import yaml

    from edge.sim.generator.house import HELD_OUT
    from exporters.choice.collect import load_views, make_views
    from exporters.choice.export import DETECTOR, MODELS, TEXT
    from exporters.choice.features import Trunk, make_features
    from exporters.choice.training import Data, Plan, train

    if args.houses > HELD_OUT:
        raise ExportError(f"--houses {args.houses}: at most {HELD_OUT}, the others are held out")
    paths = make_views(range(args.houses), args.out / "views", args.cores)
    measured = range(HELD_OUT, HELD_OUT + args.held_out)
    make_views(measured, args.out / "held-out", args.cores)
    trunk = Trunk(MODELS / f"{DETECTOR}.onnx", MODELS / f"{TEXT}.onnx")
    views, features = load_views(paths), make_features(paths, trunk)
    logging.info("%d views of %d houses", len(views), args.houses)
    (args.out / "run.yaml").write_text(yaml.safe_dump({"houses": args.houses}))
    torch.set_num_threads(1)  # tensors this small gain nothing by more
    data = Data(views, features, trunk.scales, trunk.words)
    train(data, Plan(seed=args.seed), len(trunk.words), args.out / "checkpoint.pt")


if __name__ == "__main__":
    sys.exit(main())
