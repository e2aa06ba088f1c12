"""`edge models list --check`: checks the hash, interface and output of model files.

A model is loaded and run in a separate process, whose program is this module. So a model that hangs
or crashes costs only one line of output.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from edge.host.children import python_module
from edge.models.make import load_single_file_card
from edge.models.pull import NO_FILE, cards_of
from edge.perception.detection import kernels
from edge.perception.detection.onnx import far_px
from edge.perception.masks.ground import class_map, pixels_of
from edge.perception.process import wire
from edge.perception.process.child import as_memory_error, set_up_child
from edge.perception.process.link import ModelProcessClient
from edge.perception.process.wire import FrameFile
from edge.perception.runtime import card_types
from edge.perception.runtime.card_types import (
    ChoiceCard,
    DetectCard,
    FileCard,
    GroundCard,
    ImageCard,
    MarksCard,
    MaskDecoderCard,
    MaskEncoderCard,
    TranslateCard,
)
from edge.perception.runtime.cards import ModelError, all_cards, verify_file, verify_model
from edge.perception.runtime.health import WHY_INVALID, log_progress
from edge.perception.runtime.kserve import KServeSession
from edge.perception.runtime.onnx_file import MASK_OUTPUTS
from edge.perception.runtime.sessions import CPU_ONLY, DTYPES, open_session
from edge.perception.scoring.choice.letter_scorer import both_questions
from edge.perception.scoring.choice.question import LETTERS, MAX_MARKS, SYSTEM
from edge.perception.scoring.vlm.model import FIRST_RUN_S, LanguageModel
from edge.text import one_line, redact

PROGRAM = python_module("edge.models.check")
_TEXTS, _MARKS = 2, 2  # numbers of texts, and of marks in an image, for the test inference
_TARGET = "chair"  # target of the test questions
_VIEW_HWC = (480, 640, 3)  # shape of the test image: height, width, channels


def run(args: argparse.Namespace) -> int:
    """Handle `edge models list --check`; return 1 if a check fails.

    Raises:
        ModelError: no such card, or `--file` was given for a card without a file.
    """
    if args.file is not None:
        if args.name is None:
            raise ModelError("--file needs the NAME of the card to check the file against")
        return _report([(load_single_file_card(args.name), args.file)], args.timeout)
    if args.name is not None:
        cards = cards_of(args.name)
        if not cards:
            print(f"{args.name}: {NO_FILE}")
        return _report([(card, None) for card in cards], args.timeout)
    present = [file for card in all_cards() for file in card.files if file.is_here()]
    if not present:
        print(
            "no model files on this machine: see `edge models list`, then `edge models pull NAME`",
            file=sys.stderr,
        )
        return 1
    return _report([(file, None) for file in present], args.timeout)


def _report(models: list[tuple[FileCard | ChoiceCard, Path | None]], limit_s: float) -> int:
    """Print a line for each model, failures to stderr; return 1 if any check failed."""
    failed = 0
    for card, file in models:
        try:
            print(check_in_subprocess(card, file, limit_s))
        except ModelError as error:
            print(error, file=sys.stderr)
            failed += 1
    return 1 if failed else 0


def check_in_subprocess(
    card: FileCard | ChoiceCard,
    file: Path | None,
    limit_s: float,
    providers: Sequence[str] = CPU_ONLY,
    limit: str = "--timeout",
) -> str:
    """Run `check_model` in a process that is killed after `limit_s`; return its result line.

    `limit` is the name of `limit_s` for the error message.
    """
    if isinstance(card, FileCard) and card.server is not None and file is None:
        return check_model(card)  # the model runs on a server, so it cannot harm this process
    request = {
        "kind": type(card).__name__,
        "card": card.model_dump(mode="json"),
        "file": None if file is None else str(file),
        "providers": providers,
    }
    with (
        closing(FrameFile()) as frames,
        closing(ModelProcessClient(request, card.name, frames, PROGRAM)) as link,
    ):
        header = link.wait_ready(limit_s, lambda: False, log_progress, limit)
    return str(header.get("said"))


def main() -> int:
    """Check the model that stdin names; the entry point of the separate process."""
    request, _, control, _ = set_up_child()  # the request, and the connection for the answer
    try:
        card = getattr(card_types, request["kind"]).model_validate(request["card"])
        file = None if request["file"] is None else Path(request["file"])
        line = check_model(card, file, request["providers"])
    except Exception as error:
        control.send(wire.encode_error(as_memory_error(error)))
        return 1
    control.send(wire.encode(said=line))
    return 0


def check_model(
    card: FileCard | ChoiceCard, file: Path | None = None, providers: Sequence[str] = CPU_ONLY
) -> str:
    """Check hash, format, names and shapes of a model, and run it once on noise.

    Args:
        card: card of the model.
        file: file to check instead of that of the card. Without a known hash, the hash is skipped.
        providers: execution providers of the run; not for a ChoiceCard or a model on a server.

    Returns:
        The result in one line.

    Raises:
        ModelError: a check failed; the message says what to do.
    """
    if isinstance(card, ChoiceCard):
        return _check_choice(card)
    if card.server is not None and file is None:
        return _check_remote(card)
    if file is None:
        path, compared = verify_model(card), True
    else:
        path, compared = file, verify_file(card, file)
    session = open_session(path, providers, threads=2)
    details = _CHECKS.get(type(card), _check_encoder)(path, session, card)
    hashed = "hash" if compared else "hash not known"
    return f"{card.name}: ok ({hashed}, interface, {details})"


def _check_remote(card: DetectCard | ImageCard) -> str:
    """Check a model on its server; see `check_model`."""
    session, where = KServeSession(card), redact(card.server.url)
    try:
        check = _check_detector if isinstance(card, DetectCard) else _check_encoder
        details = check(where, session, card)
    finally:
        session.close()
    tensors = "bytes" if session.binary else "JSON, which is slow"
    return f"{card.name}: ok (on {where}, interface, {details}; tensors go as {tensors})"


# Each of these checks runs a model on noise, and returns what it found, for the result line.


def _check_detector(path: Path | str, session: Any, card: DetectCard) -> str:
    """Detect two random texts in an image of noise."""
    random = np.random.default_rng(0)
    text = random.normal(size=(1, _TEXTS, card.text_dim)).astype(np.float32)
    text /= np.linalg.norm(text, axis=2, keepdims=True)
    images = random.random((1, 3, card.input.height, card.input.width), dtype=np.float32)
    boxes, scores = _infer(path, session, {"images": images, "txt_feats": text})
    a = boxes.shape[1] if boxes.ndim == 3 else 0
    _check_output(path, "boxes", boxes, (1, a, 4))
    _check_output(path, "scores", scores, (1, a, _TEXTS))
    # As in the running service, with one text for each class.
    class_scores = np.empty_like(scores[0])
    kernels.best_per_class(scores[0], np.arange(_TEXTS, dtype=np.int32), class_scores)
    if n := kernels.count_invalid(boxes[0], class_scores, far_px(card)):
        raise ModelError(
            f"{path}: {n} of {a} boxes are {WHY_INVALID}: scores must be from 0 to 1 (after the "
            "sigmoid), boxes in pixels of the input: export the model again"
        )
    return f"{a} boxes, finite"


def _check_choice(card: ChoiceCard) -> str:
    """Check all files, and ask both questions of ViTL about an image of noise."""
    model = LanguageModel(card, both_questions(MAX_MARKS, _TARGET))
    noise = np.random.default_rng(0).integers(0, 255, _VIEW_HWC, np.uint8)
    view = noise if model.takes_images else "The robot sees:\n- nothing that it knows"
    began = time.perf_counter()
    # Probabilities of the answers to the two questions: letters of directions; Yes and No.
    p, scene = model.ask(SYSTEM, view, both_questions(_MARKS, _TARGET), FIRST_RUN_S)
    took_ms = (time.perf_counter() - began) * 1e3
    letters = ", ".join(f"{letter} {share:.2f}" for letter, share in zip(LETTERS, p, strict=False))
    return (
        f"{card.name}: ok (hashes of {len(card.parts)} files, interface, template, tokens; "
        f"of noise: {letters}, Yes {scene[0]:.2f}; {took_ms:.0f} ms)"
    )


def _check_marks(path: Path | str, session: Any, card: MarksCard) -> str:
    """Choose among random marks in an image of noise."""
    feed = _noise(session)
    feed["marks"][..., -1] = 1.0  # each mark is there
    directions, scene = _infer(path, session, feed)
    _check_output(path, "directions", directions, (1, MAX_MARKS + 1))
    _check_output(path, "scene", scene, (1, 1))
    return f"{MAX_MARKS} marks, finite"


def _check_encoder(path: Path | str, session: Any, card: FileCard) -> str:
    """Encode an image of noise, or two texts of padding."""
    if isinstance(card, ImageCard):
        random, rows = np.random.default_rng(0), 1
        shape = (1, 3, card.input.height, card.input.width)
        feed = {"pixels": random.random(shape, dtype=np.float32)}
    else:
        length, rows = session.get_inputs()[0].shape[1], _TEXTS
        feed = {"tokens": np.zeros((rows, length if isinstance(length, int) else 3), np.int64)}
    (found,) = _infer(path, session, feed)
    _check_output(path, "embeddings", found, (rows, card.dim))
    if not np.linalg.norm(found, axis=1).all():
        raise ModelError(f"{path}: an embedding is all zeros: export the model again")
    return f"embeddings of {card.dim}, finite"


def _check_mask_encoder(path: Path, session: Any, card: MaskEncoderCard) -> str:
    """Encode an image of noise."""
    found = _infer(path, session, _noise(session))
    for value, array in zip(session.get_outputs(), found, strict=True):
        _check_output(path, value.name, array, array.shape)
    return f"features {', '.join(str(array.shape) for array in found)}, finite"


def _check_ground(path: Path, session: Any, card: GroundCard) -> str:
    """Name the classes of an image of noise."""
    noise = np.random.default_rng(0).integers(
        0, 255, (card.input.height, card.input.width, 3), np.uint8
    )
    feed = {session.get_inputs()[0].name: pixels_of(noise, card)}
    classes = class_map(_infer(path, session, feed)[0], card)
    rows, columns = classes.shape
    return f"{len(card.classes)} classes in {rows}x{columns} pixels"


def _check_mask_decoder(path: Path, session: Any, card: MaskDecoderCard) -> str:
    """Decode one box on features of noise."""
    feed = _noise(session)
    # In SAM, labels 2 and 3 say that the points are two corners of a box.
    feed["point_coords"] = np.array([[[0, 0], [64, 64]]], np.float32)
    feed["point_labels"] = np.array([[2, 3]], feed["point_labels"].dtype)
    if "orig_im_size" in feed:
        feed["orig_im_size"][:] = 64
    names = {value.name for value in session.get_outputs()}
    output = next(name for name in MASK_OUTPUTS if name in names)
    (masks,) = _infer(path, session, feed, [output])
    if masks.ndim != 4 or len(masks) != 1:
        raise ModelError(
            f"{path}: {output} of shape {masks.shape}, must be (1, k, rows, columns): export "
            "the model again"
        )
    _check_output(path, output, masks, masks.shape)
    return f"masks {masks.shape}, finite"


def _check_translator(path: Path, session: Any, card: TranslateCard) -> str:
    """Decode one token from a text of one token.

    The outputs are keys and values of the encoder, logits, and keys and values of the decoder.
    """
    across, logits, present = _infer(path, session, _noise(session))
    _check_output(path, "across", across, across.shape)
    _check_output(path, "present", present, present.shape)
    _check_output(path, "logits", logits, (1, 1, logits.shape[-1]))
    return f"{logits.shape[-1]} tokens, finite"


_CHECKS = {
    DetectCard: _check_detector,
    MaskEncoderCard: _check_mask_encoder,
    MaskDecoderCard: _check_mask_decoder,
    MarksCard: _check_marks,
    GroundCard: _check_ground,
    TranslateCard: _check_translator,
}
"""Class of the card → check of its model; all other models are encoders of one embedding."""


def _noise(session: Any) -> dict[str, np.ndarray]:
    """Return inputs in [0, 1), integers 0; a size that the network leaves free is 1."""
    random = np.random.default_rng(0)
    return {
        v.name: random.random([n if isinstance(n, int) else 1 for n in v.shape], np.float32)
        .astype(DTYPES[v.type])
        for v in session.get_inputs()
    }  # fmt: skip


def _infer(
    path: Path | str, session: Any, feed: dict[str, np.ndarray], outputs: list[str] | None = None
) -> list[np.ndarray]:
    """Run a session; raise ModelError if that fails."""
    try:
        return session.run(outputs, feed)
    except ModelError:  # from a server, with a complete message
        raise
    except Exception as error:  # onnxruntime raises many types of its own
        reason = one_line(error)
        raise ModelError(f"{path}: does not run: {reason}: export the model again") from None


def _check_output(path: Path | str, name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raise ModelError if an output has another shape, or is not finite."""
    if array.shape != shape:
        raise ModelError(
            f"{path}: {name} of shape {array.shape}, must be {shape}: export the model again"
        )
    if not np.isfinite(array).all():
        raise ModelError(f"{path}: returns {name} that are not finite: export the model again")


if __name__ == "__main__":
    sys.exit(main())
