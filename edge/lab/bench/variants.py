"""Variants that `edge bench --models` compares: each detector of a family on each provider here.

A provider runs a model on certain hardware. Here it has a short name, a key of `PROVIDERS`.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from typing import NamedTuple

from edge.errors import UnavailableError, UserError
from edge.perception.runtime.card_types import DetectCard, DirectionsCard
from edge.perception.runtime.cards import all_cards
from edge.perception.runtime.sessions import TENSORRT

PROVIDERS = {
    "cpu": ("CPUExecutionProvider",),
    "cuda": ("CUDAExecutionProvider",),
    "ort-tensorrt": ("TensorrtExecutionProvider", "CUDAExecutionProvider"),
    "tensorrt": (TENSORRT,),
}
"""Short name of a provider -> onnxruntime's names of it, the preferred one first. TensorRT runs
inside onnxruntime (`ort-tensorrt`) or without it (`tensorrt`)."""
_PRECISIONS = ("fp32", "fp16", "int8-cpu", "int8-trt")  # in the order of the table
# Precisions whose zero points are not 0: TensorRT refuses them, and CUDA has no kernels for them.
_CPU_ONLY = ("int8-cpu",)


class Variant(NamedTuple):
    """One detector (model card) on one provider.

    Attributes:
        provider: a name of `PROVIDERS`.
    """

    card: DetectCard
    provider: str


def families() -> list[str]:
    """Return the families that have a detector."""
    return sorted({card.family for card in all_cards() if isinstance(card, DetectCard)})


def variants(family: str, providers: Sequence[str]) -> list[Variant]:
    """Return the variants of a family, sorted by provider, then input size, then precision.

    Raises:
        UserError: the family has no detector; the message lists those that have one.
    """
    cards = [c for c in all_cards() if isinstance(c, DetectCard) and c.family == family]
    if not cards:
        choices = ", ".join(families()) or "none"
        raise UserError(
            f"bench --models: no detector has the family {family!r} (choices: {choices})"
        )
    cards.sort(key=lambda c: (c.input.height * c.input.width, _PRECISIONS.index(c.precision)))
    return [
        Variant(card, name)
        for name in PROVIDERS
        if name in providers
        for card in cards
        if runs_on(card, name)
    ]


def runs_on(card: DetectCard | DirectionsCard, provider: str) -> bool:
    """Return True if a card can run on a provider of `PROVIDERS`."""
    return provider == "cpu" or card.precision not in _CPU_ONLY


def providers_here(asked: str | None) -> list[str]:
    """Return the names of `PROVIDERS` to use on this machine.

    These are all that it has, or those asked for, with commas between.

    Raises:
        UserError: neither onnxruntime nor TensorRT is installed, or none has a provider asked for.
    """
    available = _available()
    if not available:
        raise UnavailableError(
            "onnxruntime is not installed; run: pip install 'edge-vln[cpu]' (or [gpu])"
        )
    # A provider is here if all of its onnxruntime providers are.
    here = [on for on, providers in PROVIDERS.items() if available.issuperset(providers)]
    if asked is None:
        return here
    wanted = [word.strip() for word in asked.split(",")]
    for word in wanted:
        if word not in here:
            raise UserError(
                f"bench --models: --providers: {word!r} is not available on this machine "
                f"(choices: {', '.join(here)})"
            )
    return wanted


def _available() -> set[str]:
    """Return the providers of the installed packages (onnxruntime's names); starts none of them."""
    found = set()
    if importlib.util.find_spec("onnxruntime") is not None:
        import onnxruntime

        found.update(onnxruntime.get_available_providers())
    if importlib.util.find_spec("tensorrt") is not None:
        found.add(TENSORRT)
    return found
