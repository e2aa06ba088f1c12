"""Parity check of detectors: how closely one detector repeats another after an export step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edge.host.progress import with_progress
from edge.lab.bench.boxes import DetectedBoxes, match_to_reference, overlaps
from exporters.files import ExportError
from exporters.images import CENTRED, Border, TextEmbeddings, load_input
from exporters.onnx_format import check_format, cpu_session
from exporters.reports import Report

SCORE_THRESHOLD = 0.3
"""Boxes with lower scores are no detections."""
NMS_IOU = 0.5
"""Boxes of a class with a larger overlap are one detection."""
SCORE_BAND = (0.05, 0.3)
"""Scores below the detection threshold that the policy still weighs (VL-Nav eq. 3)."""

Model = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""(images (1, 3, H, W), txt_feats (1, n, 512)) → boxes (1, A, 4) xyxy px, scores (1, A, n)."""


# Limits of the figures of `ParityReport`, by the precision of the candidate; see `reports.AT_MOST`.
FP32_LIMITS = {"recall": 1.0, "precision": 1.0, "score_error": 0.01, "max_abs_diff": 0.01}
FP16_LIMITS = {"recall": 0.97, "precision": 0.95, "score_error": 0.05}
INT8_LIMITS = {"recall": 0.95, "precision": 0.8}


@dataclass(frozen=True)
class ParityReport(Report):
    """Agreement of a candidate's detections with a reference's.

    Attributes:
        detections: reference detections at `SCORE_THRESHOLD` after class-wise NMS.
        recall: share of these that the candidate also has (see `match_to_reference`).
        precision: share of the candidate's detections that the reference also has.
        score_error: mean of |candidate - reference| / reference over every anchor and class whose
            reference score is in `SCORE_BAND`; NaN if there is none.
        max_abs_diff: largest difference of any two scores.
    """

    images: int
    detections: int
    recall: float
    precision: float
    score_error: float
    max_abs_diff: float

    def for_card(self, reference: str) -> dict:
        """Return the figures that a card keeps (`card_types.Parity`)."""
        unknown = math.isnan(self.score_error)
        return {
            "reference": reference,
            "images": self.images,
            "recall": round(self.recall, 3),
            "precision": round(self.precision, 3),
            "score_error": None if unknown else round(self.score_error, 3),
        }

    def accept(self, what: str, reference: str, limits: Mapping[str, float] | None) -> None:
        """Also raise ExportError if the reference detects nothing; see `Report.accept`."""
        super().accept(what, reference, limits)
        if limits is not None and not self.detections:
            raise ExportError(
                f"{what}: the original model detects nothing above {SCORE_THRESHOLD} in "
                f"{self.images} images, so the new model cannot be compared; give images that show "
                "the objects"
            )


def select_boxes(
    xyxy_px: np.ndarray, scores: np.ndarray, threshold: float = SCORE_THRESHOLD
) -> DetectedBoxes:
    """Return boxes (A, 4) with scores (A, n) above a threshold, after class-wise NMS."""
    anchor, class_id = np.nonzero(scores > threshold)
    order = np.argsort(-scores[anchor, class_id], kind="stable")
    anchor, class_id = anchor[order], class_id[order]
    boxes = xyxy_px[anchor]
    is_same = (overlaps(boxes, boxes)[0] > NMS_IOU) & (class_id[:, None] == class_id[None])
    kept = np.ones(len(boxes), bool)
    for row in range(len(boxes)):
        if kept[row]:
            kept[row + 1 :] &= ~is_same[row, row + 1 :]
    return DetectedBoxes(boxes[kept], scores[anchor, class_id][kept], class_id[kept])


def compare(
    reference: Model, candidate: Model, images: Iterable[np.ndarray], txt_feats: np.ndarray
) -> ParityReport:
    """Run both models over images (1, 3, H, W), and compare their detections.

    `txt_feats` are (1, n, 512) embeddings of the prompts.
    """
    count = matched = wanted = found = 0
    errors: list[np.ndarray] = []
    worst = 0.0
    for image in images:
        count += 1
        ref_boxes, ref_scores = _finite("reference", reference(image, txt_feats), count)
        cand_boxes, cand_scores = _finite("candidate", candidate(image, txt_feats), count)
        ref, cand = select_boxes(ref_boxes, ref_scores), select_boxes(cand_boxes, cand_scores)
        matched += match_to_reference(ref, cand).hits
        wanted += len(ref.score)
        found += len(cand.score)
        band = (ref_scores >= SCORE_BAND[0]) & (ref_scores < SCORE_BAND[1])
        errors.append(np.abs(cand_scores[band] - ref_scores[band]) / ref_scores[band])
        worst = max(worst, float(np.abs(cand_scores - ref_scores).max(initial=0.0)))
    error = np.concatenate(errors) if errors else np.empty(0)
    return ParityReport(
        images=count,
        detections=wanted,
        recall=matched / wanted if wanted else 1.0,
        precision=matched / found if found else 1.0,
        score_error=float(error.mean()) if error.size else float("nan"),
        max_abs_diff=worst,
    )


def _finite(
    which: str, outputs: tuple[np.ndarray, np.ndarray], image: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return boxes (A, 4) and scores (A, n) of one image; raise ExportError if not finite."""
    for name, output in zip(("boxes", "scores"), outputs, strict=True):
        if bad := int(np.count_nonzero(~np.isfinite(output))):
            raise ExportError(
                f"the {which}'s {name} of image {image}: {bad} of {output.size} values are not "
                "finite; check the export of the model"
            )
    return outputs[0][0], outputs[1][0]


def onnx_model(path: Path) -> tuple[Model, tuple[int, int]]:
    """Return an ONNX detector on the CPU, and its input height and width in pixels."""
    check_format(path)
    session = cpu_session(path, threads=2)
    height, width = session.get_inputs()[0].shape[2:]

    def run(images: np.ndarray, txt_feats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        boxes, scores = session.run(["boxes", "scores"], {"images": images, "txt_feats": txt_feats})
        return boxes, scores

    return run, (height, width)


def torch_model(detector: object) -> Model:
    """Return a torch detector as a parity model."""
    import torch

    def run(images: np.ndarray, txt_feats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with torch.inference_mode():
            boxes, scores = detector(torch.from_numpy(images), torch.from_numpy(txt_feats))
        return boxes.numpy(), scores.numpy()

    return run


def measure(
    reference: Model | Path,
    candidate: Path,
    images: list[Path],
    text: TextEmbeddings,
    border: Border = CENTRED,
) -> ParityReport:
    """Compare an ONNX file with a reference model or ONNX file, on image files."""
    run, hw = onnx_model(candidate)
    if isinstance(reference, Path):
        reference, _ = onnx_model(reference)
    inputs = (load_input(path, hw, border) for path in with_progress("pictures: compared", images))
    return compare(reference, run, inputs, text.emb[None])
