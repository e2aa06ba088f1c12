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

SEED, HOUSES, HELD_OUT_HOUSES, CORES = 0, "0:130", "1000:1020", 2
STEPS = 1800


def seeds(option: str, text: str) -> list[int]:
    """The numbers of half-open ranges, in their order.

    >>> seeds("--houses", "0:3,7:9")
    [0, 1, 2, 7, 8]
    """
    try:
        ends = [part.split(":") for part in text.split(",")]
        ranges = [range(int(first), int(end)) for first, end in ends]
    except ValueError:
        ranges = []
    if not ranges or not all(ranges) or min(r.start for r in ranges) < 0:
        raise ExportError(f"{option} {text}: give ranges such as 0:60 or 0:10,50:60")
    return [seed for one in ranges for seed in one]


@tells_errors
def main(argv: list[str] | None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m exporters.train_choice",
        description="train the small choice scorer on what a robot sees in generated houses",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of views and weights")
    parser.add_argument("--seed", type=int, default=SEED, help="of the training; default: 0")
    parser.add_argument(
        "--houses", default=HOUSES,
        help="seeds of those to train on, as half-open ranges (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--held-out", default=HELD_OUT_HOUSES,
        help="seeds of those to measure on (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--steps", type=int, default=STEPS, help="default: %(default)s")
    parser.add_argument("--cores", type=int, default=CORES, help="processes that explore")
    args = parser.parse_args(argv)
    for option in ("steps", "cores"):
        if getattr(args, option) < 1:
            raise ExportError(f"--{option} {getattr(args, option)}: give at least 1")
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    _train(args)


def _train(args: argparse.Namespace) -> None:
    import torch
    import yaml

    from edge.lab.sim.generator.house import HELD_OUT
    from exporters.choice.collect import load_views, make_views
    from exporters.choice.export import DETECTOR, MODELS, TEXT
    from exporters.choice.features import Trunk, make_features
    from exporters.choice.training import Data, Plan, train

    houses, measured = seeds("--houses", args.houses), seeds("--held-out", args.held_out)
    if max(houses) >= HELD_OUT or min(measured) < HELD_OUT:
        raise ExportError(f"seeds from {HELD_OUT} on are held out, those below are to train on")
    paths = make_views(houses, args.out / "views", args.cores)
    make_views(measured, args.out / "held-out", args.cores)
    trunk = Trunk(MODELS / f"{DETECTOR}.onnx", MODELS / f"{TEXT}.onnx")
    views, features = load_views(paths), make_features(paths, trunk)
    logging.info("%d views of %d houses", len(views), len(houses))
    made = {"houses": args.houses, "held-out": args.held_out, "count": len(houses)}
    (args.out / "run.yaml").write_text(yaml.safe_dump(made))
    torch.set_num_threads(1)  # tensors this small gain nothing by more
    data = Data(views, features, trunk.scales, trunk.words)
    plan = Plan(seed=args.seed, steps=args.steps)
    train(data, plan, len(trunk.words), args.out / "checkpoint.pt")


if __name__ == "__main__":
    sys.exit(main())
