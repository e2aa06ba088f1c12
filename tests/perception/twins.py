"""Plain Python twins of the perception kernels."""

from __future__ import annotations

import numpy as np

from edge.perception.detection.kernels import ROUNDING
from edge.perception.tracking.back_projection_kernels import (
    CLAIM_RATIO,
    LEAST_ON_MASK,
    MAX_IOU,
    OTHER_M,
)
from edge.perception.tracking.look_kernels import LOOK_MIN_M, LOOK_RIM, OCCLUDED_M, WHOLE_SHARE
from edge.perception.tracking.object_kernels import FORGET, PARTIAL, PRIOR, SAME_M, WITHIN


def to_planes(rgb, scale, top, left, out):
    h, w = rgb.shape[:2]
    out[:, top : top + h, left : left + w] = rgb.transpose(2, 0, 1).astype(np.float32) * scale


def iou(a, b):
    w, h = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    if w <= 0 or h <= 0:
        return 0.0
    area = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1])
    return w * h / (area - w * h)


def fold(scores, thing):
    with np.errstate(invalid="ignore"):
        nearly = (scores >= -ROUNDING) & (scores <= 1 + ROUNDING)
    scores = np.where(nearly, scores.clip(0, 1), scores)
    return np.stack([scores[:, thing == k].max(axis=1) for k in range(thing.max() + 1)], axis=1)


def sound(boxes, scores, far_px):
    return (abs(boxes) <= far_px).all(axis=1) & ((scores >= 0) & (scores <= 1)).all(axis=1)


def candidates(boxes, scores, n_targets, tau, far_px):
    """(anchor, label, score, top, invalid)."""
    whole = sound(boxes, scores, far_px)
    clean = np.where(whole[:, None] & (scores >= tau), scores, 0).astype(np.float32)
    anchor, label = np.nonzero(clean[:, :n_targets])
    return anchor, label, clean[anchor, label], clean.max(axis=1), int((~whole).sum())


def suppress(boxes, anchor, label, score, labels, one_word, iou_max, limit):
    """Return the indices of the kept candidates whose label is in `labels`."""
    kept = []
    for i in sorted(range(len(score)), key=lambda i: (-score[i], i)):
        if len(kept) == limit:
            break
        others = [j for j in kept if one_word or label[i] == label[j]]
        apart = all(iou(boxes[anchor[i]], boxes[anchor[j]]) <= iou_max for j in others)
        if label[i] in labels and apart:
            kept.append(i)
    return kept


def strongest_competing_scores(
    boxes, scores, competes, tau, far_px, anchor, label, keep, cut, iou_max
):
    """Return the best score of a competing class at each kept box."""
    clean = np.where(sound(boxes, scores, far_px)[:, None] & (scores >= tau), scores, 0).astype(
        np.float32
    )
    best = []
    for k, part in zip(keep, cut, strict=True):
        i = anchor[k]
        place = [j == i or iou(boxes[i], b) > iou_max for j, b in enumerate(boxes)]
        best.append(clean[place][:, competes[int(part), label[k]]].max(initial=0.0))
    return np.array(best, np.float32)


def object_boxes(ids, depth, n):
    """(box, pixels, mean distance) of objects 1..n."""
    box, pixels, distance = [], [], []
    for i in range(1, n + 1):
        ys, xs = np.nonzero(ids == i)
        z = depth[ys, xs]
        z = z[np.isfinite(z) & (z > 0)]
        here = (xs.min(), ys.min(), xs.max() + 1, ys.max() + 1) if len(xs) else None
        box.append(here or (ids.shape[1], ids.shape[0], 0, 0))
        pixels.append(len(xs))
        distance.append(z.mean() if len(z) else 0.0)
    return np.array(box), np.array(pixels), np.array(distance)


def cloud_raster(cloud, T, fx, fy, cx, cy, cell_px, shape):
    """Index of the nearest point of every cell, -1 where none is."""
    raster = np.full(shape, -1)
    nearest = np.full(shape, np.inf)
    for i, point in enumerate(cloud.astype(np.float64)):
        if not np.isfinite(point).all():
            continue
        x, y, z = T[:3, :3] @ point + T[:3, 3]
        if z < 0.05:
            continue
        c = int(np.floor((fx * x / z + cx + 0.5) / cell_px))
        r = int(np.floor((fy * y / z + cy + 0.5) / cell_px))
        if 0 <= r < shape[0] and 0 <= c < shape[1] and np.float32(z) < nearest[r, c]:
            nearest[r, c], raster[r, c] = np.float32(z), i
    return raster


def grid_of(low, high, side):
    """Return the positions along one axis at which a box is sampled."""
    step = max(1, -(-(high - low) // side))
    return range(low + step // 2, high, step)


def sample_depth(depth, fx, fy, cx, cy, box, max_range, side):
    """Points (k, 3) of a box in the optical frame."""
    h, w = depth.shape
    u0, v0 = max(0, int(box[0])), max(0, int(box[1]))
    u1, v1 = min(w, int(box[2]) + 1), min(h, int(box[3]) + 1)
    points = []
    for v in grid_of(v0, v1, side):
        for u in grid_of(u0, u1, side):
            z = float(depth[v, u])
            if 0 < z <= max_range:
                points.append(((u - cx) / fx * z, (v - cy) / fy * z, z))
    return np.array(points, np.float32).reshape(-1, 3)


def without_others(samples, view, boxes, word, mine, depth, claim):
    """Drop samples inside another class's box that fits nearly as well, at its depths."""
    fx, fy, cx, cy = view[4:]
    u = fx * samples[:, 0] / samples[:, 2] + cx
    v = fy * samples[:, 1] / samples[:, 2] + cy
    keep = np.ones(len(samples), bool)
    box = boxes[mine]
    for other, (near, far), fits, of in zip(boxes, depth, claim, word, strict=True):
        if fits <= CLAIM_RATIO * float(claim[mine]) or of == word[mine]:
            continue
        apart = np.minimum(other[2:], box[2:]) <= np.maximum(other[:2], box[:2])
        if apart.any() or iou(other, box) > MAX_IOU:
            continue
        inside = (other[0] <= u) & (u <= other[2]) & (other[1] <= v) & (v <= other[3])
        z = samples[:, 2]
        keep &= ~(inside & (near - OTHER_M <= z) & (z <= far + OTHER_M))
    return samples[keep]


def surfaces(z, max_range, bins, gap_m, sparse):
    """(k, 3): (low, high, how many) of the surfaces among depths, nearest first."""
    width = max_range / bins
    gap = max(2, int(np.ceil(gap_m / width)))
    counts = np.bincount(np.minimum((z / width).astype(int), bins - 1), minlength=bins)
    filled = np.flatnonzero(counts > len(z) // sparse)
    groups = np.split(filled, np.flatnonzero(np.diff(filled) > gap) + 1)
    found = [(g[0] * width, (g[-1] + 1) * width, counts[g].sum()) for g in groups if len(g)]
    return np.array(found, np.float64).reshape(-1, 3)


def going_on(strips, low, high, T, floor_z):
    """Mean share of the strips' points that are between two depths, above the floor."""
    shares = []
    for points in strips:
        if len(points):
            height = points @ T[2, :3] + T[2, 3]
            inside = (points[:, 2] >= low) & (points[:, 2] <= high) & (height > floor_z)
            shares.append(inside.mean())
    return float(np.mean(shares)) if shares else 0.0


def merge_points(old, support, new, voxel_m, cap, near_m):
    """(points, support): one point per voxel, at most `cap`."""
    joined = np.concatenate((old, new))
    apart = np.linalg.norm(joined[:, None, :2].astype(np.float64) - joined[None, :, :2], axis=2)
    close, k = apart <= near_m, len(old)
    counts = np.ones(len(joined), int)
    counts[:k] = support + close[:k, k:].any(axis=1)
    for j in range(k, len(joined)):
        counts[j] = counts[:k][close[j, :k]].max(initial=1)
    keys = np.floor(joined / np.float64(voxel_m)).astype(np.int64)
    _, first = np.unique(keys, axis=0, return_index=True)
    kept = min(len(first), cap)
    chosen = first[np.arange(kept) * len(first) // kept]
    return joined[chosen], counts[chosen]


def nearby(wall, x0, y0, cell, xy, things, row, weight, radius, kinds):
    """See `edge.perception.prior.nearby.nearby`."""
    out = np.zeros((len(xy), kinds), np.float32)
    for i, place in enumerate(xy):
        for (x, y), k, w in zip(things[:, :2], row, weight, strict=True):
            d = np.array([x - place[0], y - place[1]], np.float32)
            if k < 0 or d @ d > radius**2:
                continue
            length = np.sqrt(d[0] * d[0] + d[1] * d[1])
            steps = np.arange(1, int((length - 0.25) / cell) + 1) / max(length, 1e-9)
            c = np.floor((place[0] - x0) / cell + steps * d[0]).astype(int)
            r = np.floor((place[1] - y0) / cell + steps * d[1]).astype(int)
            inside = (r >= 0) & (r < wall.shape[0]) & (c >= 0) & (c < wall.shape[1])
            if not wall[r[inside], c[inside]].any():
                out[i, k] = max(out[i, k], w)
    return out


def match(centers, points, n_points, word, of_word, x, y, merge_m):
    """Index of the nearest record of a word, or -1."""
    best, least = -1, merge_m
    for i in np.flatnonzero(word == of_word):
        places = np.vstack((centers[i], points[i, : n_points[i]]))[:, :2]
        apart = np.hypot(*(places - np.array((x, y), np.float64)).T).min()
        if apart < least:
            best, least = int(i), apart
    return best


def strongest_competing_score(
    surface, centers, points, n_points, word, confidence, against, reach_m
):
    """Return the highest mean confidence of another class over the surface."""
    middle = surface[:, :2].mean(axis=0)
    cover = np.zeros((len(against), len(surface)))
    for i in range(len(word)):
        mine = points[i, : n_points[i]]
        if against[word[i]] == 0 or not len(mine):
            continue
        near = np.abs(mine[:, None] - surface[None]).max(axis=2) < SAME_M
        if np.hypot(*(centers[i, :2] - middle)) > reach_m:
            continue
        share = min(1.0, near.any(axis=1).mean() / WITHIN)
        cover[word[i]] = np.maximum(cover[word[i]], near.any(axis=0) * share * confidence[i])
    return (against * cover.mean(axis=1)).max()


def share_in_view(points, T, view):
    fx, fy, cx, cy, width, height = view
    x, y, z = T[:3, :3] @ points.astype(np.float64).T + T[:3, 3:]
    z = np.where(z > 0, z, np.nan)
    u, v = fx * x / z + cx, fy * y / z + cy
    return ((u >= 0) & (u < width) & (v >= 0) & (v < height)).mean() if len(points) else 0.0


def look_weight(xyz, points, T, view, depth, near_m, far_m):
    fx, fy, cx, cy, width, height = view
    x, y, z = T[:3, :3] @ xyz + T[:3, 3]
    if not 0.1 < z < far_m:
        return 0.0
    u, v = fx * x / z + cx, fy * y / z + cy
    if not (0 <= u < width and 0 <= v < height) or 0 < depth[int(v), int(u)] < z - OCCLUDED_M:
        return 0.0
    across, down = u / width, v / height
    whole = LOOK_RIM < across < 1 - LOOK_RIM and LOOK_RIM < down < 1 - LOOK_RIM and z > LOOK_MIN_M
    whole &= not len(points) or share_in_view(points, T, view) >= WHOLE_SHARE
    return min(1.0, (near_m / z) ** 2) * (1.0 if whole else PARTIAL)


def fuse(
    centers, points, n_points, word, now, asked, T, view, depth, near_m, far_m, weight, total,
    confidence,
):  # fmt: skip
    """One look at every record."""
    for i in range(len(word)):
        w = look_weight(
            centers[i].astype(np.float64), points[i, : n_points[i]], T, view, depth, near_m, far_m
        )
        w = max(w, PARTIAL**2) if now[i] > 0 else w
        if asked[word[i]] and w > 0:
            half = 0.5 if weight[i] + w > FORGET else 1.0
            weight[i] = half * (weight[i] + w)
            total[i] = half * (total[i] + w * now[i])
            confidence[i] = total[i] / (weight[i] + PRIOR)
    now[:] = 0.0


def rasterised(values, origin, scale, box, side):
    """Bilinear look-up of `values` at the middle of each cell over a box; -1 outside."""
    around = np.pad(values, 1, constant_values=-1)
    out = np.empty((side, side))
    for r in range(side):
        for c in range(side):
            x = (box[0] + (c + 0.5) / side * (box[2] - box[0]) - origin[0]) * scale[0] + 0.5
            y = (box[1] + (r + 0.5) / side * (box[3] - box[1]) - origin[1]) * scale[1] + 0.5
            u, v = int(np.floor(x)), int(np.floor(y))
            if not (0 <= u < around.shape[1] - 1 and 0 <= v < around.shape[0] - 1):
                out[r, c] = -1
                continue
            a, b = x - u, y - v
            top = (1 - a) * around[v, u] + a * around[v, u + 1]
            out[r, c] = (1 - b) * top + b * ((1 - a) * around[v + 1, u] + a * around[v + 1, u + 1])
    return out


def on_mask(samples, view, box, mask):
    """Return the samples on a box's mask; all of them if hardly any are."""
    *_, fx, fy, cx, cy = view
    rows, columns = mask.shape
    kept = []
    for x, y, z in samples:
        u = (fx * x / z + cx + 0.5 - box[0]) / (box[2] - box[0]) * columns
        v = (fy * y / z + cy + 0.5 - box[1]) / (box[3] - box[1]) * rows
        if 0 <= u < columns and 0 <= v < rows and mask[int(v), int(u)]:
            kept.append((x, y, z))
    return np.array(kept) if len(kept) >= LEAST_ON_MASK * len(samples) else samples
