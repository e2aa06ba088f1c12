"""Loss of the small detector: the assignment of anchors to objects, and the error of the outputs.

An anchor is a cell of one of the detector's heads; it has a box and a score for each phrase.
Shapes: b images, a anchors, o objects, k phrases.

Task-aligned assignment (TOOD, arXiv:2108.07755, section 3.2), distribution focal loss
(arXiv:2006.04388, eq. 6) and complete IoU (arXiv:1911.08287, eq. 10).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812 - the usual name

from exporters.training.mini.looks import UNSURE, YES
from exporters.training.mini.net import BINS

TOP_K = 10
"""Largest number of anchors for one object."""
SCORE_POWER, IOU_POWER = 0.5, 4.0
"""Exponents of score and overlap in the alignment of an anchor with an object (TOOD)."""
BOX_WEIGHT, EDGE_WEIGHT = 7.5, 1.5
"""Weights of the loss of boxes, and of the loss of edge distributions."""
HARD_WEIGHT = 2.0
"""Weight of the error of a phrase that names an object's category with a wrong colour or size."""


@dataclass(frozen=True, slots=True)
class Labels:
    """Objects in a batch of images, and the answers to the phrases; o objects per image, padded.

    Attributes:
        boxes: (b, o, 4) float32 x0 y0 x1 y1 in input pixels.
        taught: (b, o) bool; False for padding, and for objects that are too small or hidden.
        answers: (b, o, k) int8 YES, NO, UNSURE per phrase; NO for padding.
        hard: (b, o, k) bool, True if the phrase names the category with a wrong colour or size.
    """

    boxes: Tensor
    taught: Tensor
    answers: Tensor
    hard: Tensor


def iou(a: Tensor, b: Tensor, complete: bool = False) -> Tensor:
    """Return the intersection over union of boxes (…, 4).

    With `complete`, it is reduced by the distance of the centres and the difference of the shapes
    (complete IoU).
    """
    wh = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(0)
    inter = wh[..., 0] * wh[..., 1]
    a_wh, b_wh = a[..., 2:] - a[..., :2], b[..., 2:] - b[..., :2]
    union = a_wh[..., 0] * a_wh[..., 1] + b_wh[..., 0] * b_wh[..., 1] - inter + 1e-7
    value = inter / union
    if not complete:
        return value
    hull = torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])
    diagonal = (hull**2).sum(-1) + 1e-7
    offset = ((a[..., :2] + a[..., 2:] - b[..., :2] - b[..., 2:]) ** 2).sum(-1) / 4
    angle_a = torch.atan(a_wh[..., 0] / (a_wh[..., 1] + 1e-7))
    angle_b = torch.atan(b_wh[..., 0] / (b_wh[..., 1] + 1e-7))
    v = 4 / math.pi**2 * (angle_a - angle_b) ** 2
    with torch.no_grad():
        alpha = v / (v - value + 1 + 1e-7)
    return value - offset / diagonal - alpha * v


@torch.no_grad()
def assign(scores: Tensor, boxes: Tensor, anchors: Tensor, labels: Labels) -> tuple[Tensor, Tensor]:
    """Return the object that each anchor is assigned to, and the quality of the assignment.

    The scores (b, a, k) are in 0..1. The anchors have boxes (b, a, 4) and centres (a, 2) [px].

    Returns:
        Index of the object (b, a) int64, -1 for none, and quality (b, a) in 0..1.
    """
    inside = _inside(anchors, labels.boxes) & labels.taught[:, None]
    overlap = iou(boxes[:, :, None], labels.boxes[:, None]).clamp(0) * inside  # (b, a, o)
    # The score of an anchor for an object: the mean over the phrases that are true of the object.
    is_true = (labels.answers == YES).to(scores.dtype)
    count = is_true.sum(-1)[:, None]
    score = torch.bmm(scores, is_true.transpose(1, 2)) / count.clamp(1)
    score = torch.where(count > 0, score, torch.ones_like(score))
    metric = score.clamp(1e-6) ** SCORE_POWER * overlap**IOU_POWER
    # An object that no box overlaps yet gets some of the anchors inside it.
    metric = metric + 1e-9 * inside
    top = metric.topk(min(TOP_K, metric.shape[1]), dim=1)
    chosen = torch.zeros_like(metric).scatter_(1, top.indices, 1.0) * (metric > 0)
    # An anchor that several objects have chosen goes to the one that its box overlaps most.
    best, owner = (overlap * chosen + 1e-6 * chosen).max(-1)
    owner = torch.where(best > 0, owner, torch.full_like(owner, -1))
    is_owner = chosen * F.one_hot(owner.clamp(0), metric.shape[2]) * (owner >= 0)[..., None]
    metric = metric * is_owner
    # The best anchor of an object gets the object's largest overlap as its quality (TOOD).
    most = metric.amax(1, keepdim=True).clamp(1e-12)
    quality = metric / most * (overlap * is_owner).amax(1, keepdim=True)
    return owner, quality.amax(-1)


def _inside(anchors: Tensor, boxes: Tensor) -> Tensor:
    """Return (b, a, o) bool: True if the anchor is in the box."""
    low = (anchors[None, :, None] > boxes[:, None, :, :2]).all(-1)
    return low & (anchors[None, :, None] < boxes[:, None, :, 2:]).all(-1)


def detection_loss(
    box: Tensor, decoded: Tensor, logits: Tensor, anchors: Tensor, stride: Tensor, labels: Labels
) -> tuple[Tensor, dict[str, Tensor]]:
    """Return the loss of a batch, and its parts by name.

    Args:
        box: (b, a, 4, BINS) distributions of the box edges as logits.
        decoded: (b, a, 4) the boxes that these mean.
        logits: (b, a, k) scores before the sigmoid.
        anchors: (a, 2) centres of the anchors [px].
        stride: (a, 1) sizes of the anchors' cells [px].
        labels: the objects.
    """
    owner, quality = assign(logits.sigmoid(), decoded, anchors, labels)
    at = owner.clamp(0)[..., None]  # index of the owner; 0 without one, which `has_owner` masks
    has_owner = (owner >= 0)[..., None]
    k = logits.shape[2]
    answers = labels.answers.gather(1, at.expand(-1, -1, k)) * has_owner
    hard = labels.hard.gather(1, at.expand(-1, -1, k)) & has_owner
    target = quality[..., None] * (answers == YES)
    # A phrase is doubtful at anchors inside an object for which it is unsure, or that is not
    # taught. It is not taught there, unless it is true or hard for the anchor's own object.
    inside = _inside(anchors, labels.boxes).to(logits.dtype)
    ignored = labels.answers == UNSURE
    ignored |= (labels.answers == YES) & ~labels.taught[..., None]
    doubtful = torch.bmm(inside, ignored.to(logits.dtype)) > 0
    weight = 1.0 + (HARD_WEIGHT - 1.0) * hard
    weight = weight * ~((answers == UNSURE) | (doubtful & (answers != YES) & ~hard))
    total = target.sum().clamp(1.0)
    class_loss = F.binary_cross_entropy_with_logits(logits, target, weight, reduction="sum") / total

    box_weight = quality[owner >= 0]
    if len(box_weight):
        wanted = labels.boxes.gather(1, at.expand(-1, -1, 4))[owner >= 0]
        weight_sum = box_weight.sum().clamp(1.0)
        each_box = 1 - iou(decoded[owner >= 0], wanted, complete=True)
        box_loss = (each_box * box_weight).sum() / weight_sum
        centre = anchors.expand(len(box), -1, -1)[owner >= 0]
        side = stride.expand(len(box), -1, -1)[owner >= 0]
        # Distribution focal loss: each edge is between two bins, which share its weight.
        edges = torch.cat([centre - wanted[:, :2], wanted[:, 2:] - centre], -1) / side
        edges = edges.clamp(0, BINS - 1.01)
        low = edges.long()
        high_share = edges - low
        rows = box[owner >= 0].reshape(-1, BINS).log_softmax(-1)
        at_low = rows.gather(1, low.reshape(-1, 1))[:, 0]
        at_high = rows.gather(1, low.reshape(-1, 1) + 1)[:, 0]
        f = high_share.reshape(-1)
        each_edge = -((1 - f) * at_low + f * at_high).reshape(-1, 4).mean(-1)
        edge_loss = (each_edge * box_weight).sum() / weight_sum
    else:
        box_loss = edge_loss = decoded.sum() * 0.0  # a zero that has gradients
    loss = class_loss + BOX_WEIGHT * box_loss + EDGE_WEIGHT * edge_loss
    parts = {"classes": class_loss, "boxes": box_loss, "edges": edge_loss}
    return loss, {name: part.detach() for name, part in parts.items()}
