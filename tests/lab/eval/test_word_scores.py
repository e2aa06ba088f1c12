from __future__ import annotations

import numpy as np
import pytest

from edge.cli.main import main
from edge.lab.eval.word_scores import NEVER, LabelledImage, WordCount, score_for
from edge.types import Detections, Observation


@pytest.mark.parametrize(
    ("wrong", "right", "score"),
    [
        ([], [], None),
        ([], [0.9] * 7, None),
        ([], [0.4] * 8, 0.3),
        ([0.42], [0.8] * 10, 0.45),
        ([0.8] * 2, [0.8] * 10, NEVER),
        ([0.5], [0.4] * 10 + [0.8] * 7, NEVER),  # only seven are left from 0.55 on
    ],
)
def test_the_lowest_score_at_which_enough_detections_are_right(wrong, right, score):
    count = WordCount(0, 0, [*wrong, *right], [False] * len(wrong) + [True] * len(right))
    assert score_for(count, 0.95, 0.3) == score


BED, SOFA, SOFA_BED = (10, 10, 40, 30), (50, 40, 70, 55), (0, 40, 20, 60)
CASES = {
    "nothing found": ((), 0, [], []),
    "found": ((BED,), 1, [True], []),
    "taken for it": ((SOFA,), 0, [False], ["sofa"]),
    "a kind of it, out of range": ((SOFA_BED,), 0, [True], []),
    "no object": (((60, 0, 80, 20),), 0, [], []),
}


@pytest.mark.parametrize(("boxes", "seen", "right", "mistaken"), CASES.values(), ids=CASES)
def test_boxes_of_a_word_against_the_objects(boxes, seen, right, mistaken):
    labels = {1: "sofa bed", 2: "sofa", 3: "bed"}  # a sofa bed is a bed
    ids, depth_m = image(SOFA_BED, SOFA, BED)
    depth_m[ids == 1] = 9.0  # out of range: no view, but it may be what a box shows
    count = LabelledImage(ids, depth_m, labels, 6.0).count("bed", found(*boxes))
    assert (count.views, count.seen) == (1, seen)
    assert (count.right, list(count.mistaken)) == (right, mistaken)


def found(*boxes: tuple[int, int, int, int]) -> Detections:
    return Detections(
        Observation(seq=0, stamp_ns=0, T_map_base=np.eye(4)),
        np.array(boxes, np.float32).reshape(-1, 4), np.full(len(boxes), 0.8, np.float32),
        np.zeros(len(boxes), np.int32), ("bed",),
    )  # fmt: skip


def image(*boxes: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    ids, depth_m = np.zeros((60, 80), np.uint16), np.full((60, 80), 2.0, np.float32)
    for k, (x0, y0, x1, y1) in enumerate(boxes, start=1):
        ids[y0:y1, x0:x1] = k
    return ids, depth_m


def test_the_command_prints_words_of_the_detector_and_what_to_configure(capsys):
    arguments = ["eval", "words", "demo", "--worlds", "generated[3]", "--poses", "3"]
    assert main([*arguments, "--precision", "1"]) == 0
    table, lines = capsys.readouterr().out.split("\n\n")
    words = [row.split("  ")[0] for row in table.splitlines()]
    assert words[0] == "word"
    assert {"bed", "chair"}.intersection(words)
    assert lines.startswith("perception:\n  confirm_scores:")
