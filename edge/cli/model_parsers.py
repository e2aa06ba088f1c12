"""What `edge models …` takes, and which function does it."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.cli.options import CONFIG, count, lazy, positive

_CARD = "a card's name, as `edge models list` shows it"
_NO_GATE = "keep a model that misses its parity's limits"


def add(commands) -> None:  # type: ignore[no-untyped-def]
    """`edge models`, with a subcommand for everything that can be done with models."""
    models = commands.add_parser("models", help="list, fetch, make, check and change models")
    actions = models.add_subparsers(required=True, metavar="ACTION", title="actions")
    for name, (text, add_to, module, function) in _ACTIONS.items():
        action = actions.add_parser(name, help=text, description=text)
        add_to(action)
        action.set_defaults(handler=lazy(f"edge.{module}", function))


def _list(action: argparse.ArgumentParser) -> None:
    action.add_argument("--json", action="store_true", help="print the cards as JSON")


def _pull(action: argparse.ArgumentParser) -> None:
    action.add_argument("name", help=_CARD)
    action.add_argument(
        "--from", dest="places", action="append", default=[], metavar="PLACE",
        help="a file, a folder or a URL to try before the card's sources; may be repeated",
    )  # fmt: skip
    action.add_argument("--offline", action="store_true", help="use no network")


def _export(action: argparse.ArgumentParser) -> None:
    option = action.add_argument
    option("name", help=f"{_CARD}; of a folder, a new one")
    option(
        "--weights", type=Path, metavar="FILE",
        help="the .pt file, or a model's folder of Hugging Face; default: as pulled",
    )  # fmt: skip
    option("--precision", nargs="+", metavar="P", help="of CLIP or SigLIP (default: fp32)")
    option("--family", help="of a folder: its cards' family; default: NAME")
    option("--license", help="of a folder: default: what its README.md says")
    option("--calibration", type=Path, metavar="DIR", help="folder of pictures (all but fp32)")
    option("--vocabulary", type=Path, help="text embeddings (.npz)")
    option("--no-gate", action="store_true", help=_NO_GATE)


def _quantize(action: argparse.ArgumentParser) -> None:
    option = action.add_argument
    option("name", help=_CARD)
    option("--calibration", type=Path, required=True, metavar="DIR", help="folder of pictures")
    option("--precision", nargs="+", metavar="P", help="of a vision-language model's FP32 (q4)")
    option("--vocabulary", type=Path, help="text embeddings (.npz); default: as `edge run` has")
    option("--no-gate", action="store_true", help=_NO_GATE)


def _check(action: argparse.ArgumentParser) -> None:
    action.add_argument("name", nargs="?", help=f"{_CARD}; default: all whose file is there")
    action.add_argument("--file", type=Path, help="hold this file against the card")
    action.add_argument(
        "--timeout", type=positive, default=120.0, metavar="S",
        help="how long each model may take before it is killed; default: %(default)g",
    )  # fmt: skip


def _bench(action: argparse.ArgumentParser) -> None:
    option = action.add_argument
    option("family", nargs="?", help="a family of cards; default: the configured detector's")
    option("--config", default="cpu", help=f"{CONFIG} (default: %(default)s)")
    option("--images", type=Path, metavar="DIR", help="pictures; default: frames of a house")
    option("--frames", type=count, default=50, metavar="N", help="default: %(default)s")
    option("--providers", metavar="LIST", help="comma-separated; default: all that are here")
    option("--threads", type=count, metavar="N", help="default: as configured")
    option("--json", type=Path, metavar="FILE", help="write the figures there too")
    option("--update-cards", action="store_true", help="write the figures into the cards")


def _use(action: argparse.ArgumentParser) -> None:
    action.add_argument("name", help=_CARD)
    action.add_argument("config", nargs="?", default="cpu", help=f"{CONFIG} (default: cpu)")
    action.add_argument("--force", action="store_true", help="though it misses budget or parity")
    action.add_argument(
        "--timeout", type=positive, default=600.0, metavar="S",
        help="how long to wait for the change; default: %(default)g",
    )  # fmt: skip


_ACTIONS = {
    "list": ("every model card, and whether its file is there", _list, "models.listing", "run"),
    "pull": ("fetch a model, or the weights it is made from", _pull, "models.pull", "run"),
    "export": ("make a model file from weights (extra `export`)", _export, "models.make", "export"),
    "quantize": ("make a variant from the FP32 file", _quantize, "models.make", "quantize"),
    "check": ("hash, interface and one inference", _check, "models.check", "run"),
    "bench": (
        "compare the variants of a family on this machine",
        _bench,
        "lab.bench.compare",
        "run",
    ),
    "use": ("change the model of a running service", _use, "models.use", "run"),
}
