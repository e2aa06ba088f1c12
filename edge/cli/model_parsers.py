"""The parser of `edge models`: its arguments, and the functions that handle them."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.cli.options import config_argument, dispatch_on_option, flag, lazy_handler, positive

_CARD = "name of a model card, as `edge models list` shows it"


def add_models(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge models` and its actions."""
    models = commands.add_parser(
        "models", help="list, check, download, export or switch neural models"
    )
    actions = models.add_subparsers(required=True, metavar="ACTION", title="actions")
    for name, (text, add_to) in _ACTIONS.items():
        add_to(actions.add_parser(name, help=text, description=text))


# fmt: off
def _add_list_options(action: argparse.ArgumentParser) -> None:
    option = action.add_argument
    option("name", nargs="?", help=f"{_CARD} (default: all)")
    flag(action, "--json", "print the cards as JSON")
    option("--licence", metavar="L", help="list only models under this licence (as the table names "
           "it), or under any permissive one (`permissive`)")
    flag(action, "--check",
         "check the hash, inputs and outputs of each model file, and run the file once")
    option("--file", type=Path,
           help="with --check: check this file (default: the file that the card names)")
    option("--timeout", type=positive, default=120, metavar="S",
           help="with --check: longest time for each model, in s")
    dispatch_on_option(
        action, "--check", on=lazy_handler("edge.models.check"), on_only=("--file",),
        off=lazy_handler("edge.models.listing"), off_only=("--json", "--licence"),
    )


def _add_pull_options(action: argparse.ArgumentParser) -> None:
    action.add_argument("name", help=_CARD)
    action.add_argument("--from", dest="places", action="append", default=[], metavar="PLACE",
                        help="file, folder or URL to fetch from before the card's own sources; may "
                        "be repeated")
    flag(action, "--offline", "fetch only from files and folders, not from URLs")
    action.set_defaults(handler=lazy_handler("edge.models.pull"))


def _add_export_options(action: argparse.ArgumentParser) -> None:
    option = action.add_argument
    option("name", help=f"{_CARD}; if --weights is a folder: name of the new card")
    option("--weights", type=Path, metavar="FILE", help="weights to export: a .pt file, or a model "
           "folder of Hugging Face (default: those that `edge models pull` fetched)")
    flag(action, "--quantize",
         "make the model from its FP32 file by quantization (needs edge-vln[quantize])")
    option("--precision", nargs="+", metavar="P", help="precisions of CLIP or SigLIP to make "
           "(default: fp32); with --quantize: those of a vision-language model (default: q4)")
    option("--family", help="with a folder as --weights: family of the new cards (default: NAME)")
    option("--license", help="with a folder as --weights: license of the model (default: that of "
           "its README.md)")
    option("--calibration", type=Path, metavar="DIR",
           help="folder of images to calibrate the quantization with (fp32 needs none)")
    option("--vocabulary", type=Path, help="file of text embeddings (.npz) (default with "
           "--quantize: the one that `edge run` uses)")
    flag(action, "--no-gate",
         "keep the model even if its outputs differ too much from the original's")
    option("--sha256", metavar="HASH",
           help="hash that the file of --weights must have, if its card names none")
    dispatch_on_option(
        action, "--quantize", on=lazy_handler("edge.models.make", "quantize"), on_only=(),
        off=lazy_handler("edge.models.make", "export"),
        off_only=("--weights", "--sha256", "--family", "--license"),
    )


def _add_use_options(action: argparse.ArgumentParser) -> None:
    action.add_argument("name", help=_CARD)
    config_argument(action, "cpu")
    flag(action, "--force", "switch even if the new model is too slow or finds too few objects")
    action.add_argument("--timeout", type=positive, default=600, metavar="S",
                        help="how long to wait for the switch, in s")
    action.set_defaults(handler=lazy_handler("edge.models.use"))
# fmt: on


_ACTIONS = {
    "list": ("list the model cards and their files, or check the files", _add_list_options),
    "pull": ("download a model file, or the weights to export it from", _add_pull_options),
    "export": (
        "make a model file from weights (edge-vln[export]), or quantize one",
        _add_export_options,
    ),
    "use": ("switch the model of a running service", _add_use_options),
}
