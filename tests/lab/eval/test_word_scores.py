from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_recall import image

from edge.cli.main import main
from edge.config import PerceptionConfig
from edge.lab.eval.word_scores import NEVER, LabelledImage, ObjectEvidence, WordCount, score_for
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
    "found": ((BED,), {3: 0}, 1),
    "taken for it": ((SOFA,), {2: 0}, 0),
    "the end of a bed": (((32, 8, 42, 32),), {3: 0}, 0),
    "a kind of it, out of range": ((SOFA_BED,), {}, 0),
    "no object": (((60, 0, 80, 20),), {}, 0),
    "twice": ((BED, BED), {3: 0}, 1),
}


@pytest.mark.parametrize(("boxes", "shown", "seen"), CASES.values(), ids=CASES)
def test_boxes_of_a_word_against_the_objects(boxes, shown, seen):
    labels = {1: "sofa bed", 2: "sofa", 3: "bed"}  # a sofa bed is a bed
    ids, depth_m = image(SOFA_BED, SOFA, BED)
    depth_m[ids == 1] = 9.0  # out of range
    image_ = LabelledImage(ids, depth_m, labels, 6.0)
    assert image_.shown("bed", found(*boxes)) == shown
    assert image_.views("bed", found(*boxes)) == (1, seen)


PERCEPTION = PerceptionConfig(
    detector={"kind": "sim"}, tau_det=0.3, confirm_lead=1.5, confirm_mean=0.2
)


@pytest.mark.parametrize(
    ("boxes", "views", "score"),
    [
        ([], 0, None),
        ([(0.8, 0.0)], 1, None),  # one image confirms nothing
        ([(0.8, 0.1), (0.5, 0.1)], 2, 0.5),
        ([(0.8, 0.1), (0.29, 0.1)], 2, None),  # too weak
        ([(0.8, 0.1), (0.5, 0.1)], 7, None),  # seldom detected
        ([(0.8, 0.5), (0.5, 0.4)], 2, None),  # it may be something else
        ([(0.8, 0.0), (0.5, 0.6)], 2, None),  # something else in one of two images
    ],
)
def test_an_object_counts_if_the_robot_would_confirm_it(boxes, views, score):
    evidence = ObjectEvidence()
    for strength, competing in boxes:
        competing_score = np.array([competing], np.float32)
        box = replace(
            found(BED), score=np.array([strength], np.float32), competing_score=competing_score
        )
        evidence.add(box, 0)
    assert evidence.confirms(views, PERCEPTION) == (score is not None)
    if score is not None:
        assert evidence.score == pytest.approx(score)


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
