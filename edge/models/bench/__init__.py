"""`edge models bench`: every variant of a family on the same frames (VL-Nav section V.D)."""

from __future__ import annotations

import argparse


def run(args: argparse.Namespace) -> int:
    """Handle `edge models bench`; see `edge.models.bench.command`."""
    from edge.models.bench.command import run  # the workers import this package too

    return run(args)
