"""The arguments of `edge models`, and which function does what."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.cli.options import CONFIG, lazy, positive, switched

_CARD = "a card's name, as `edge models list` shows it"


def add(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge models` and its actions."""
    models = commands.add_parser("models", help="list, check, fetch, make and change models")
    actions = models.add_subparsers(required=True, metavar="ACTION", title="actions")
    for name, (text, add_to) in _ACTIONS.items():
        add_to(actions.add_parser(name, help=text, description=text))


def _list(action: argparse.ArgumentParser) -> None:
    option = action.add_argument
    option("name", nargs="?", help=f"{_CARD}; default: all")
    option("--json", action="store_true", help="print the cards as JSON")
    option("--check", action="store_true", help="hash, interface and one inference of each file")
    option("--file", type=Path, help="with --check: hold this file against the card")
    option(
        "--timeout", type=positive, default=120.0, metavar="S",
        help="with --check: how long each model may take before it is killed; default: %(default)g",
    )  # fmt: skip
    check, show = lazy("edge.models.check", "run"), lazy("edge.models.listing", "run")
    switched(action, "--check", check, ("--file",), show, ("--json",))


def _pull(action: argparse.ArgumentParser) -> None:
    action.add_argument("name", help=_CARD)
    action.add_argument(
        "--from", dest="places", action="append", default=[], metavar="PLACE",
        help="a file, a folder or a URL to try before the card's sources; may be repeated",
    )  # fmt: skip
    action.add_argument("--offline", action="store_true", help="use no network")
    action.set_defaults(handler=lazy("edge.models.pull", "run"))


def _export(action: argparse.ArgumentParser) -> None:
    option = action.add_argument
    option("name", help=f"{_CARD}; of a folder, a new one")
    option(
        "--weights", type=Path, metavar="FILE",
        help="the .pt file, or a model's folder of Hugging Face; default: as pulled",
    )  # fmt: skip
    option(
        "--quantize", action="store_true",
        help="make it from its FP32 file, which is here (extra `quantize`)",
    )  # fmt: skip
    option(
        "--precision", nargs="+", metavar="P", help="of CLIP or SigLIP (default: fp32), or of a "
        "vision-language model that is quantized (default: q4)",
    )  # fmt: skip
    option("--family", help="of a folder: its cards' family; default: NAME")
    option("--license", help="of a folder: default: what its README.md says")
    option("--calibration", type=Path, metavar="DIR", help="folder of pictures (all but fp32)")
    option(
        "--vocabulary", type=Path, help="text embeddings (.npz); with --quantize by default as "
        "`edge run` has them",
    )  # fmt: skip
    option("--no-gate", action="store_true", help="keep a model that misses its parity's limits")
    export, quantize = lazy("edge.models.make", "export"), lazy("edge.models.make", "quantize")
    of_weights = ("--weights", "--family", "--license")
    switched(action, "--quantize", quantize, (), export, of_weights)


def _use(action: argparse.ArgumentParser) -> None:
    action.add_argument("name", help=_CARD)
    action.add_argument("config", nargs="?", default="cpu", help=f"{CONFIG} (default: cpu)")
    action.add_argument("--force", action="store_true", help="though it misses budget or parity")
    action.add_argument(
        "--timeout", type=positive, default=600.0, metavar="S",
        help="how long to wait for the change; default: %(default)g",
    )  # fmt: skip
    action.set_defaults(handler=lazy("edge.models.use", "run"))


_ACTIONS = {
    "list": ("every model card, and whether its file is there or sound", _list),
    "pull": ("fetch a model, or the weights it is made from", _pull),
    "export": ("make a model file from weights (extra `export`), or a variant of one", _export),
    "use": ("change the model of a running service", _use),
}
