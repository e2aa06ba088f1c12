"""`edge models check`: is a model's file whole, what its card says, and of sound answers?"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from edge.perception.cards import DetectCard, ModelError, all_cards, load_card, verify_model
from edge.perception.onnx_detector import OUTPUTS
from edge.perception.runtime import open_session


def run(args: argparse.Namespace) -> int:
    """Handle `edge models check`; 1 when a model is not sound.

    Raises:
        ModelError: the card that was named is none, or its model is not sound.
    """
    return check_models(args.name)


def check_models(name: str | None) -> int:
    """Check one model, or all whose file is there; prints a line each."""
    if name is not None:
        print(check_model(load_card(name)))
        return 0
    present = [card for card in all_cards() if card.task == "detect" and card.path.is_file()]
    if not present:
        print("no model files here: run `edge models list` for what there is", file=sys.stderr)
        return 1
    failed = 0
    for card in present:
        try:
            print(check_model(card))
        except ModelError as error:
            print(error, file=sys.stderr)
            failed += 1
    return 1 if failed else 0


def check_model(card: DetectCard) -> str:
    """Hash, loading, names and shapes, and one inference on noise.

    Returns:
        One line that says what was found.

    Raises:
        ModelError: with what is wrong and what to do.
    """
    path = verify_model(card)
    session = open_session(path, ["CPUExecutionProvider"], threads=2)
    random = np.random.default_rng(0)
    shape = (1, 3, card.input.height, card.input.width)
    text = random.normal(size=(1, 2, card.text_dim)).astype(np.float32)
    text /= np.linalg.norm(text, axis=2, keepdims=True)
    feed = {"images": random.random(shape, dtype=np.float32), "txt_feats": text}
    boxes, scores = session.run(list(OUTPUTS), feed)
    a = boxes.shape[1]
    if boxes.shape != (1, a, 4) or scores.shape != (1, a, 2):
        raise ModelError(
            f"{path}: boxes {boxes.shape}, scores {scores.shape}; must be (1, a, 4) and (1, a, 2): "
            "export it again"
        )
    if not (np.isfinite(boxes).all() and np.isfinite(scores).all()):
        raise ModelError(f"{path}: returns values that are not finite: export it again")
    if scores.min() < 0.0 or scores.max() > 1.0:
        raise ModelError(f"{path}: scores must lie in 0..1 (after the sigmoid): export it again")
    return f"{card.name}: ok (hash, interface, {a} boxes, finite)"
