"""Fit of the prior's weights to samples, with validation on other houses.

Each target has a logistic model: the log-odds that it stands near a place are a bias plus a weight
for each object seen near the place.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from edge.perception.prior import rooms
from edge.perception.prior.table import SCALE, ObjectPrior
from exporters.training.prior.samples import Samples
from exporters.training.results import auc

FOLDS = 4
"""Parts of the houses for the validation: each is predicted by a model of the other parts."""
_HOUSE_WEIGHT = 8.0
"""Total weight of a house's samples, since they are many views of the same objects."""
_RIDGE = 10.0  # penalty on the squared weights
_DROPOUT = 0.4  # share of the objects that are left out in a second copy of each sample
_MOST_STEPS = 15  # of Newton's method
_SMALL_STEP = 0.02  # Newton's method ends when no weight changes by more
_SLIGHT = 5
"""Weights of less than this many hundredths are left out of the table."""
_LEAST_HOUSES = 40
"""A target in fewer houses has no model."""
# Values to try for `ObjectPrior.room_power` and `ObjectPrior.evidence`.
_GRID = np.round(np.arange(0.0, 1.01, 0.1), 2)


class Score(NamedTuple):
    """Quality of a target's prediction in held-out houses; each house has the same weight.

    Attributes:
        houses: number of houses in which the target was searched.
        share: share of the places that are near the target.
        base: log loss in nats if the share in the other houses is predicted everywhere.
        loss: log loss in nats of the model.
        error: standard error of base - loss, over houses.
        auc: probability that a place near the target ranks above one that is not.
    """

    houses: int
    share: float
    base: float
    loss: float
    error: float
    auc: float


class Fit(NamedTuple):
    """A target's model.

    Attributes:
        beta: (m + 1,) weight of each object, and the bias (last).
        score: quality in held-out houses.
        rows: indices of the samples that count for the target.
        log_ratio: log likelihood ratio of each of these, by a model of other houses; 0 if nothing
            was seen near the place.
    """

    beta: np.ndarray
    score: Score
    rows: np.ndarray
    log_ratio: np.ndarray

    @property
    def has_opinion(self) -> bool:
        """True if the model predicts other houses better than the target's share does."""
        return self.score.base - self.score.loss > self.score.error


def folds(n_houses: int) -> np.ndarray:
    """Return the fold of each house."""
    return np.random.default_rng(5).permutation(n_houses) % FOLDS


def fit_near(samples: Samples, target: int, begin: np.ndarray | None = None) -> np.ndarray:
    """Return the weights of one target's model (`ObjectPrior.near_weight`), see `Fit.beta`.

    A start value `begin`, such as a fit to similar samples, saves most of the steps.
    """
    wanted = samples.wanted[:, target]
    near = samples.near[wanted].astype(np.float32)
    found, weight = samples.found[wanted, target].astype(float), _weights(samples.house[wanted])
    random = np.random.default_rng(target)
    # Each sample counts twice with half its weight: as it is, and with objects left out.
    dropped = near * (random.random(near.shape) >= _DROPOUT)
    return _logistic(
        np.concatenate((near, dropped)), np.tile(found, 2), np.tile(0.5 * weight, 2), begin
    )


def cross_fit(samples: Samples, target: int) -> Fit | None:
    """Return a target's model, validated on held-out houses; None if too few houses have it."""
    wanted = np.flatnonzero(samples.wanted[:, target])
    house = samples.house[wanted]
    if len(np.unique(house)) < _LEAST_HOUSES:
        return None
    beta = fit_near(samples, target)
    fold = folds(int(samples.house.max()) + 1)[house]
    found, weight = _truth(samples, wanted, target)
    # For each sample, by models of the other folds.
    p, base, log_ratio = np.empty(len(wanted)), np.empty(len(wanted)), np.empty(len(wanted))
    for k in range(FOLDS):
        held_out = fold == k
        other = fit_near(_only(samples, wanted[~held_out]), target, beta)
        p[held_out] = _sigmoid(samples.near[wanted[held_out]] @ other[:-1] + other[-1])
        base[held_out] = np.average(found[~held_out], weights=weight[~held_out])
        log_ratio[held_out] = np.log(p[held_out]) - np.log(_sigmoid(other[-1]))
    gain = _loss(base, found) - _loss(p, found)
    by_house = np.bincount(house, gain * weight)[np.unique(house)] / _HOUSE_WEIGHT
    score = Score(
        len(by_house),
        float(np.average(found, weights=weight)),
        float(np.average(_loss(base, found), weights=weight)),
        float(np.average(_loss(p, found), weights=weight)),
        float(by_house.std() / np.sqrt(len(by_house))),
        auc(p, found),
    )
    return Fit(beta, score, wanted, log_ratio)


def near_part(fits: dict[int, Fit], classes: tuple[str, ...]) -> dict[str, Any]:
    """Return the `near` part of a table's file.

    A target has weights only if its model predicts held-out houses better than the target's share
    does, by a standard error (`Fit.has_opinion`).
    """
    bias, weights = [0] * len(classes), {}
    for target, fit in fits.items():
        if fit.has_opinion:
            hundredths = np.rint(SCALE * fit.beta).astype(int).tolist()
            bias[target] = hundredths.pop()  # the last entry of `beta`
            weights[classes[target]] = {
                name: v for name, v in zip(classes, hundredths, strict=True) if abs(v) >= _SLIGHT
            }
    return {"bias": bias, "weight": weights}


def fit_evidence(samples: Samples, table: ObjectPrior) -> float:
    """Return the `ObjectPrior.evidence` that best predicts the kind of regions with objects."""
    informative = (samples.kind >= 0) & samples.in_region.any(1)
    seen, kind = samples.in_region[informative].astype(np.float32), samples.kind[informative]
    weight = _weights(samples.house[informative])

    def loss(evidence: float) -> float:
        p = rooms.room_posterior(replace(table, evidence=evidence), seen)
        return float(np.average(-np.log(p[np.arange(len(p)), kind]), weights=weight))

    return float(min(_GRID[1:], key=loss))


def room_log_ratio(samples: Samples, table: ObjectPrior, target: int) -> np.ndarray:
    """Return the log likelihood ratio of each sample from the rooms only: (n,) float64."""
    seen = (part.astype(np.float32) for part in (samples.in_region, samples.in_adjacent))
    posterior = rooms.room_posterior_at(table, *seen)
    return np.log(rooms.likelihood_ratio(table, target, posterior))


def fit_powers(
    samples: Samples, table: ObjectPrior, fits: dict[int, Fit]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the best `ObjectPrior.room_power`, and its gain in log loss (share of the base's).

    Each is a pair: without near objects, and in addition to them.

    The likelihood ratio of near objects comes from models of other houses. That of the rooms comes
    from the table, whose counts are few and coarse.
    """
    # Gain at each power: of the rooms alone, and of near objects with the rooms.
    gain = np.zeros((2, len(_GRID)))
    for target, fit in fits.items():
        room = room_log_ratio(_only(samples, fit.rows), table, target)
        found, weight = _truth(samples, fit.rows, target)
        near = fit.log_ratio * fit.has_opinion
        for row, start in enumerate((np.zeros_like(near), near)):
            loss = [_offset_loss(start + power * room, found, weight) for power in _GRID]
            base = _offset_loss(0.0 * room, found, weight)
            gain[row] += (base - np.array(loss)) / base / len(fits)
    best = gain.argmax(1)
    alone, both = (float(_GRID[i]) for i in best)
    # Power 0 leaves the rooms out, so gain[1, 0] is that of the near objects.
    return (alone, both), (float(gain[0, best[0]]), float(gain[1, best[1]] - gain[1, 0]))


def reliability(samples: Samples, fits: dict[int, Fit], edges: np.ndarray) -> Iterator[tuple]:
    """Yield (predicted likelihood ratio, observed ratio, number of places) of each bin.

    Both ratios are means over the bin's places, relative to the mean over all places.
    """
    predicted, true, weights = [], [], []
    for target, fit in fits.items():
        if not fit.has_opinion:
            continue
        found, weight = _truth(samples, fit.rows, target)
        ratio = np.exp(fit.log_ratio)
        predicted.append(ratio / np.average(ratio, weights=weight))
        true.append(found / np.average(found, weights=weight))
        weights.append(weight)
    if not predicted:
        return
    p, t, w = map(np.concatenate, (predicted, true, weights))
    bins = np.digitize(p, edges)
    for k in np.unique(bins):
        at = bins == k
        yield np.average(p[at], weights=w[at]), np.average(t[at], weights=w[at]), int(at.sum())


def _only(samples: Samples, rows: np.ndarray) -> Samples:
    return Samples(*(getattr(samples, field)[rows] for field in Samples.__slots__))


def _weights(house: np.ndarray) -> np.ndarray:
    """Return sample weights that give each house the same total weight."""
    return _HOUSE_WEIGHT / np.bincount(house)[house]


def _truth(samples: Samples, rows: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (n,) float64, 1 if the target is near, and the weight of each sample."""
    return samples.found[rows, target].astype(float), _weights(samples.house[rows])


def _sigmoid(odds: np.ndarray | float) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-np.asarray(odds)))


def _loss(p: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return the log loss of each prediction in nats."""
    p = np.clip(p, 1e-6, 1.0 - 1e-6)
    return -(found * np.log(p) + (1.0 - found) * np.log(1.0 - p))


def _offset_loss(offset: np.ndarray, found: np.ndarray, weight: np.ndarray) -> float:
    """Return the log loss of given log-odds plus an intercept that is fitted here."""
    bias = 0.0
    for _ in range(20):  # Newton's method
        p = _sigmoid(offset + bias)
        bias += (weight * (found - p)).sum() / max((weight * p * (1.0 - p)).sum(), 1e-9)
    return float(np.average(_loss(_sigmoid(offset + bias), found), weights=weight))


def _logistic(
    near: np.ndarray, found: np.ndarray, weight: np.ndarray, begin: np.ndarray | None
) -> np.ndarray:
    """Fit a logistic model by Newton's method, with a ridge on all weights but the bias (last).

    Each of n samples has inputs (n, m), an outcome of 1 or 0, and a weight. The start value `begin`
    is (m + 1,); None: zeros, and the bias from the share of the outcome.
    """
    x = np.hstack((near, np.ones((len(near), 1), np.float32)))
    share = np.average(found, weights=weight)
    beta = np.zeros(x.shape[1])
    beta[-1] = np.log((share + 1e-3) / (1.0 - share + 1e-3))
    if begin is not None:
        beta = begin.copy()
    penalty = np.full(len(beta), _RIDGE)
    penalty[-1] = 1e-3
    for _ in range(_MOST_STEPS):
        p = _sigmoid(x @ beta)
        slope = (weight * p * (1.0 - p)).astype(np.float32)
        hessian = (x * slope[:, None]).T @ x + np.diag(penalty)
        step = np.linalg.solve(hessian, x.T @ (weight * (found - p)) - penalty * beta)
        beta += step
        if np.abs(step).max() < _SMALL_STEP:
            break
    return beta
