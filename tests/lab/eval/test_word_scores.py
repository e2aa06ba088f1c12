from __future__ import annotations

import numpy as np
import pytest
from test_recall import image

from edge.cli.main import main
from edge.lab.eval.word_scores import NEVER, LabelledImage, WordCount, score_for
from edge.types import Detections, Observation

OTHERS = WordCount(scores=[0.3, 0.9], right=[False, True])  # half of all objects are right


@pytest.mark.parametrize(
    ("wrong", "right", "others", "score"),
    [
        ([], [], WordCount(), NEVER),
        ([], [], OTHERS, 0.35),  # of the objects of all words from there on, all are right
        ([], [0.3] * 8, OTHERS, 0.35),
        ([], [0.3] * 40, OTHERS, 0.3),
        ([0.42] * 2, [0.8] * 8, OTHERS, 0.45),
        ([0.96] * 4, [0.96] * 8, OTHERS, NEVER),
    ],
)
def test_score_for_finds_the_lowest_precise_score(wrong, right, others, score):
    count = WordCount(0, 0, [*wrong, *right], [False] * len(wrong) + [True] * len(right))
    assert score_for(count, others, 0.9, 0.3) == score


@pytest.mark.parametrize(("seen", "score"), [(24, NEVER), (25, 0.3)])
def test_a_rarely_detected_word_confirms_nothing(seen, score):
    assert score_for(WordCount(100, seen, [0.3] * 40, [True] * 40), OTHERS, 0.9, 0.3) == score


BED, SOFA, SOFA_BED = (10, 10, 40, 30), (50, 40, 70, 55), (0, 40, 20, 60)
CASES = {
    "nothing found": ((), {}, 0),
    "found": ((BED,), {3: 0.8}, 1),
    "taken for it": ((SOFA,), {2: 0.8}, 0),
    "a kind of it, out of range": ((SOFA_BED,), {}, 0),
    "no object": (((60, 0, 80, 20),), {}, 0),
    "twice": ((BED, BED), {3: 0.8}, 1),
}


@pytest.mark.parametrize(("boxes", "detected", "seen"), CASES.values(), ids=CASES)
def test_boxes_of_a_word_against_the_objects(boxes, detected, seen):
    labels = {1: "sofa bed", 2: "sofa", 3: "bed"}  # a sofa bed is a bed
    ids, depth_m = image(SOFA_BED, SOFA, BED)
    depth_m[ids == 1] = 9.0  # out of range
    image_ = LabelledImage(ids, depth_m, labels, 6.0)
    best, views, n_seen = image_.detected("bed", found(*boxes))
    assert best == pytest.approx(detected)
    assert (views, n_seen) == (1, seen)


def found(*boxes: tuple[int, int, int, int]) -> Detections:
    return Detections(
        Observation(seq=0, stamp_ns=0, T_map_base=np.eye(4)),
        np.array(boxes, np.float32).reshape(-1, 4), np.full(len(boxes), 0.8, np.float32),
        np.zeros(len(boxes), np.int32), ("bed",),
    )  # fmt: skip


def test_the_command_prints_word_scores_and_the_configuration(capsys):
    arguments = ["eval", "words", "demo", "--worlds", "generated[3]", "--poses", "6"]
    assert main([*arguments, "--precision", "0.5"]) == 0
    table, lines = capsys.readouterr().out.split("\n\n")
    words = [row.split("  ")[0] for row in table.splitlines()]
    assert words[0] == "word"
    assert {"bed", "chair"}.intersection(words)
    assert lines.startswith("perception:\n  confirm_score: ")
