"""Train the small detector of our own, from nothing but code and a seed.

    python -m exporters.train_mini --out DIR

Renders houses (minutes, kept in DIR/data), trains (about an hour on 2 CPU cores, minutes on a
GPU; goes on from DIR/checkpoint.pt when stopped); then `python -m exporters.mini.export DIR`
makes the ONNX files of the averaged weights.
"""

from __future__ import annotations

import argparse
import logging
import sys
from functools import partial
from pathlib import Path

HOUSES, PER_HOUSE = 3000, 11


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m exporters.train_mini")
    parser.add_argument("--out", type=Path, required=True, help="folder of data and weights")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--houses", type=int, default=HOUSES)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--device", help="cpu, cuda, … (default: cuda when there is one)")
    args = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")

    import torch

    from exporters.mini import training, views

    device = args.device or ("cuda" if torch.cuda.is_available() else "cpu")
    houses, data = range(args.houses), args.out / "data"
    make = partial(views.make_frames, houses, PER_HOUSE, data, args.cores)
    frames, plan = make(), training.Plan(seed=args.seed)
    logging.info("%d frames, %d things", len(frames), len(frames.objects))
    checkpoint = args.out / "checkpoint.pt"
    if device == "cpu":
        training.train_on_cores(make, plan, checkpoint, args.cores)
    else:
        training.train(frames, plan, checkpoint, device)
    logging.info("done: %s", checkpoint)
    return 0


if __name__ == "__main__":
    sys.exit(main())
