"""The sets D, R and B of a mission: which targets were detected, reached and failed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from edge.mission.planning.plan import MissionKnowledge


class TargetSets:
    """The sets D, R and B (ViTL IV-A2), and the object ids that they follow from.

    Args:
        known: targets that need not be detected, such as places.
        failures: failure of a target → that target. Of `known`; in B until the target is in B.

    Attributes:
        detected: the set D, labels of detected targets.
        reached: the set R, in order of reaching.
        failed: the set B, labels of failed targets.
        lost: failed targets that stay in B in all rounds.
        distance_m: see `MissionKnowledge.distance_m`; None: unknown.
    """

    def __init__(self, known: Iterable[str], failures: Mapping[str, str] | None = None) -> None:
        self._failures = dict(failures or {})
        self.detected = frozenset(known)
        self.reached: tuple[str, ...] = ()
        self.failed: frozenset[str] = frozenset()
        self.distance_m: np.ndarray | None = None
        self._why_failed: dict[str, str] = {}
        # Target → highest id of its known instances, and the same at the time when it failed.
        self._newest_ids = dict.fromkeys(self.detected, 0)
        self._stale_ids: dict[str, int] = {}
        self.lost: frozenset[str] = frozenset()

    @property
    def knowledge(self) -> MissionKnowledge:
        """The sets and the distances for the planner."""
        reached = frozenset(self.reached)
        untrue = {label for label, of in self._failures.items() if of not in self.failed}
        failed = self.failed | untrue
        return MissionKnowledge(self.detected - reached, reached, failed, self.distance_m)

    @property
    def failure_reasons(self) -> str:
        """Reasons of the failed targets; "" if none failed."""
        return "; ".join(why for label, why in self._why_failed.items() if label in self.failed)

    def failure_reason(self, label: str) -> str:
        """Return the reason of the failure that a label means; "" for another label."""
        return self._why_failed.get(self._failures.get(label, ""), "")

    def on_detections(self, newest: Mapping[str, int], keep: bool) -> frozenset[str] | None:
        """Update D from the known instances; return the new targets, None if D is the same.

        Args:
            newest: the highest instance id of each target with a known instance. A failed target
                counts as detected again only if its id is higher than at the time of failure.
            keep: True keeps targets detected that `newest` does not contain.
        """
        newest = {**self._newest_ids, **newest} if keep else newest
        if newest == self._newest_ids:
            return None
        self._newest_ids = dict(newest)
        detected = frozenset(k for k, i in newest.items() if i > self._stale_ids.get(k, -1))
        if detected == self.detected:
            return None
        new, self.detected = detected - self.detected, detected
        self.failed -= new
        return new

    def add_reached(self, label: str) -> None:
        """Add a target to R."""
        self.reached = tuple(dict.fromkeys((*self.reached, label)))

    def add_failed(self, label: str, reason: str) -> None:
        """Move a target from D to B."""
        self.failed |= {label}
        self.detected -= {label}
        self._stale_ids[label] = self._newest_ids.get(label, -1)
        self._why_failed[label] = reason

    def add_lost(self, label: str, reason: str) -> None:
        """Move a target from D to B for all rounds."""
        self.add_failed(label, reason)
        self.lost |= {label}

    def begin_round(self) -> None:
        """Empty R and B: all known targets are candidates again, except those that are lost."""
        self.reached, self.failed = (), self.lost
        self.detected = frozenset(self._newest_ids) - self.lost
        self._stale_ids = {label: self._newest_ids.get(label, -1) for label in self.lost}
        self._why_failed = {k: why for k, why in self._why_failed.items() if k in self.lost}

    def restore(
        self, reached: Iterable[str], failed: Iterable[str], lost: Iterable[str] = ()
    ) -> None:
        """Continue with saved sets."""
        self.reached, self.failed, self.lost = tuple(reached), frozenset(failed), frozenset(lost)
        self._why_failed = {label: f"{label} failed before the restart" for label in self.failed}

    def mark_stale_before(self, newest: Mapping[str, int]) -> None:
        """Mark the instances up to these ids, one for each target, as known before a restart.

        A failed target counts as detected again only with a newer instance.
        """
        self._stale_ids = {label: newest[label] for label in self.failed}
