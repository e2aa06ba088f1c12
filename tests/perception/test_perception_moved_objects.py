"""Objects that were moved: which row is the same object as one that is missing at its place."""

from __future__ import annotations

import pytest

from edge.perception.tracking.moved_objects import MAX_VANISHED, MovedObjects, VanishedObject
from edge.perception.tracking.tracked_objects import TrackedObjects

GONE = VanishedObject(7, 0, 100, 200, (1.0, 1.0, 0.0), 0)


def objects(word=0, first_seen_ns=300) -> TrackedObjects:
    """Return one certain object."""
    seen = TrackedObjects(4)
    seen.n = 1
    seen.id[0], seen.word[0], seen.hits[0], seen.first_seen_ns[0] = 9, word, 5, first_seen_ns
    return seen


@pytest.mark.parametrize("first", ["seen", "missed"])
@pytest.mark.parametrize(
    ("word", "first_seen_ns", "same"), [(0, 300, True), (1, 300, False), (0, 150, False)]
)
def test_an_object_of_the_same_word_that_came_later_is_the_same(first, word, first_seen_ns, same):
    seen = objects(word, first_seen_ns)
    moved = MovedObjects(seen)
    if first == "missed":
        moved.vanished = [GONE]
        moved.appear(0)
    else:
        moved.vanish(GONE, 3)
    assert seen.id[0] == (7 if same else 9)
    assert moved.renamed == ({9: 7} if same else {})
    assert moved.vanished == ([] if same else [GONE])
    assert seen.moves[0] == same


def test_the_oldest_vanished_objects_are_forgotten():
    moved = MovedObjects(TrackedObjects(1))
    for i in range(MAX_VANISHED + 2):
        moved.vanish(GONE._replace(id=i), 3)
    assert [one.id for one in moved.vanished] == list(range(2, MAX_VANISHED + 2))
