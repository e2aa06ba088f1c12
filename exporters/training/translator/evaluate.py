"""Evaluation of a translator's file on human sentences.

The model is measured alone, and for the sentences that the grammar cannot read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from edge.lab.eval.translate import OUTCOMES, score
from edge.lab.eval.translation_cases import TranslationCase
from edge.mission.language.networks.model import NeuralTranslator
from edge.mission.language.networks.network import TranslationNetwork
from edge.mission.translate import Translator, combined_backend, small_model_backend
from exporters.training.results import took_ms

TIMED = 300
"""Sentences for the latency measurement."""


def translators(path: Path) -> dict[str, Translator]:
    """Return translators that use a file: `model`, and `auto`, which tries the grammar first."""
    small = small_model_backend(NeuralTranslator(TranslationNetwork.from_file(path)))
    return {
        "model": Translator("model", small),
        "auto": Translator("auto", combined_backend(small, None)),
    }


def outcomes(cases: Sequence[TranslationCase], translator: Translator) -> dict[str, int]:
    """Count the cases by each of `edge.lab.eval.translate.OUTCOMES`."""
    counts = Counter(score(case, translator).outcome for case in cases)
    return {outcome: counts[outcome] for outcome in OUTCOMES}


def latency_ms(cases: Sequence[TranslationCase], translator: Translator) -> dict[str, float]:
    """Time the translation of a sentence with all its checks; return median and 95th percentile."""
    timed = cases[:: max(1, len(cases) // TIMED)]
    return took_ms(lambda index: score(timed[index], translator), len(timed))
