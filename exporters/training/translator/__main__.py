"""Command that trains the small translator on composed sentences and on human ones.

    python -m exporters.training.translator --out RUN --lang2ltl TABLE --clean-up TABLE

It learns composed sentences first. Then, for each corpus, it learns the sentences of all others and
is measured on the one left out. At last it learns all corpora; this becomes
`models/mini-translator.onnx` and its card. A stopped run continues from its checkpoint.
"""

from __future__ import annotations

import argparse
import logging
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from edge.cli.options import count
from exporters.files import exit_on_user_error, sha256_of
from exporters.training.results import publish, training_parser

NAME = "mini-translator"
MANY = 7000
"""Number of human sentences for the full share in training; fewer sentences get a smaller share."""
NOTE = "Written by exporters.training.translator."


@exit_on_user_error
def main(argv: list[str] | None) -> None:
    """Parse the command line, train, and publish the model."""
    from exporters.training.translator.training import COMPOSED, PEOPLE

    # fmt: off
    parser = training_parser("translator", "train the small model that translates instructions to "
                             "formulas", "checkpoints")
    option = parser.add_argument
    option("--lang2ltl", type=Path, help="also learn from Lang2LTL's set, its file "
           "symbolic_batch12_noperm.csv (default: not)")
    option("--clean-up", type=Path,
           help="also learn from Clean-up World's set of instructions (default: not)")
    option("--steps", type=count, default=COMPOSED.steps,
           help="training steps on composed sentences")
    option("--people-steps", type=count, default=PEOPLE.steps,
           help="training steps after that, with sentences of people, too")
    # fmt: on
    args = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    _train(args)


def _train(args: argparse.Namespace) -> None:
    """Train on composed sentences, then on the corpora, measure, and publish."""
    import torch
    import yaml

    from exporters.training.translator import evaluate
    from exporters.training.translator.compose import load
    from exporters.training.translator.data import corpora, extended, human_pairs, vocabulary_of
    from exporters.training.translator.export import export
    from exporters.training.translator.training import COMPOSED, PEOPLE, train

    torch.set_num_threads(1)  # more threads do not help with such small tensors
    args.out.mkdir(parents=True, exist_ok=True)
    phrases, cases = load(), corpora(args.lang2ltl, args.clean_up)
    pairs = {name: human_pairs(corpus, phrases) for name, corpus in cases.items()}
    composed_words = vocabulary_of(phrases, args.seed)
    plan = replace(COMPOSED, steps=args.steps, seed=args.seed)
    base = train(phrases, [], composed_words, plan, args.out / "composed.pt")

    def train_on(seen: list[str], name: str) -> tuple[Path, float]:
        """Return the file of a network that also learned these corpora, and its logit error."""
        human = [pair for corpus in seen for pair in pairs[corpus]]
        vocabulary = extended(composed_words, human)
        plan = replace(PEOPLE, steps=args.people_steps, seed=args.seed)
        plan = replace(plan, human=min(PEOPLE.human, len(human) / MANY))
        net = train(phrases, human, vocabulary, plan, args.out / f"{name}.pt", start=base)
        path = args.out / f"{name}.onnx"
        return path, export(net, vocabulary, path)

    measured: dict[str, dict[str, Any]] = {}
    for corpus in cases:
        path, _ = train_on([other for other in cases if other != corpus], f"without-{corpus}")
        for kind, translator in evaluate.translators(path).items():
            counts = evaluate.outcomes(cases[corpus], translator)
            measured[f"{corpus}, not seen, {kind}"] = counts
            logging.info("%s, not seen, %s: %s", corpus, kind, counts)
    path, logit_error = train_on(list(cases), NAME)
    all_cases = [case for corpus_cases in cases.values() for case in corpus_cases]
    figures: dict[str, Any] = {"logit_error": round(logit_error, 4), "bytes": path.stat().st_size}
    if all_cases:
        translator = evaluate.translators(path)["model"]
        figures |= evaluate.latency_ms(all_cases, translator)
    measured = {"training": _training_figures(args, pairs), "file": figures, **measured}
    card = {
        "name": NAME, "task": "translate", "family": NAME, "sources": [], "license": "Apache-2.0",
        "derived_from": None, "parity": None, "file": f"{NAME}.onnx", "sha256": sha256_of(path),
        "precision": "int8", "measured": measured,
    }  # fmt: skip
    publish({f"{NAME}.onnx": path}, [card], args.models, NOTE)
    print(yaml.safe_dump(measured, sort_keys=False))


def _training_figures(args: argparse.Namespace, pairs: dict[str, list]) -> dict[str, Any]:
    """Return the training entry of the card; `pairs` are the sentences of each corpus."""
    import torch

    tables = " ".join(f"--{name} TABLE" for name in pairs)
    return {
        "command": f"python -m exporters.training.translator --out RUN --seed {args.seed} "
        f"--steps {args.steps} --people-steps {args.people_steps} {tables}".rstrip(),
        "torch": str(torch.__version__),
        **{f"{name}_sentences": len(corpus) for name, corpus in pairs.items()},
    }


if __name__ == "__main__":
    sys.exit(main())
