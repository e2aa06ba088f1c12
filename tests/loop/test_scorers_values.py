"""Scorers write the value maps, with the camera's view at the time of the question."""

from __future__ import annotations

import math
import threading

import numpy as np
import pytest
from patience import eventually
from simulated import simulated

from edge.geometry import SE2, CameraModel, se3, to_optical
from edge.lab.eval.closed_loop import START_NS, ClosedLoop
from edge.loop.scoring.cooccurrence import PriorChoice, RelatedScores, p_object_given_word
from edge.loop.scoring.scorer_questions import mark_costs
from edge.loop.scoring.scorers import Scorers
from edge.mapping.grid import RollingMap
from edge.mission.spec import prepare
from edge.perception.prior.table import load
from edge.perception.scoring.choice.question import FrontierChoice, Mark
from edge.perception.tracking.instances import InstanceTracker
from edge.policies.base import FRONTIER, Candidates
from edge.types import ContextBoxes, Detections, Observation

CAMERA = CameraModel.from_hfov(160, 120, math.radians(75))
MOUNT = to_optical(se3(0.0, 0.0, 0.6))
BOTH = ("bed", "sofa")


def seen_from(pose: SE2, seq: int = 0, range_m: float = 4.0) -> Observation:
    """Return a view of a wall across, this far ahead."""
    depth = np.full((CAMERA.height_px, CAMERA.width_px), range_m, np.float32)
    return Observation(
        seq, seq, pose.matrix(), rgb=np.zeros((120, 160, 3), np.uint8), depth_m=depth,
        camera=CAMERA, T_base_camera=MOUNT,
    )  # fmt: skip


def frontiers(*places: tuple[float, float]) -> Candidates:
    candidates = Candidates(8)
    candidates.n = len(places)
    for i, place in enumerate(places):
        candidates.kind[i], candidates.xy_m[i], candidates.id[i] = FRONTIER, place, 7 + i
    return candidates


class Case:
    """Scorers, and a map that has its place around the origin."""

    def __init__(self, scorers: Scorers, targets=BOTH) -> None:
        config = simulated()
        self.scorers, self.targets = scorers, targets
        self.grid, self.tracker = RollingMap(config.mapping), InstanceTracker(config.perception)
        start = seen_from(SE2(0.0, 0.0, 0.0))
        self.grid.update_depth(start.depth_m, CAMERA, start.T_map_base, MOUNT)
        self.grid.values.set_targets(targets)

    def ask(self, pose: SE2, candidates: Candidates, seq: int = 1, prior=None) -> None:
        seen, values = seen_from(pose, seq), self.grid.values
        self.scorers.ask(seen, self.targets, "bed", candidates, self.tracker, values, prior)

    def best(self, *places: tuple[float, float], target: str = "bed") -> np.ndarray:
        out, xy_m = np.zeros(len(places), np.float32), np.array(places, np.float32)
        self.grid.values.best(self.targets.index(target), xy_m, len(places), 0.3, out)
        return out


class Chooser:
    """Prefers the first mark; may be made to think."""

    name = "chooser"

    def __init__(self, thinking: threading.Event | None = None) -> None:
        self.thinking, self.asked = thinking, []

    def prepare(self, view):
        self.asked.append(view.target)
        return view

    def answer(self, view):
        if self.thinking is not None:
            self.thinking.wait(30)
        ids = tuple(mark.id for mark in view.marks)
        p = np.array([0.7] + [0.1] * (len(ids) - 1), np.float32)
        return FrontierChoice(view.observation.stamp_ns, view.target, ids, p, 1.0 - p.sum(), 0.8)

    def close(self):
        pass


def test_a_late_answer_is_written_at_the_asked_pose():
    """Meanwhile the robot has turned round and the frontiers are others."""
    done = threading.Event()
    case = Case(Scorers(None, Chooser(done), value_source="choice"))
    case.ask(SE2(0.0, 0.0, 0.0), frontiers((3.0, 1.0), (3.0, -1.0)))
    case.ask(SE2(0.0, 0.0, math.pi), frontiers((-3.0, 0.0)), seq=2)
    case.scorers.collect_answers(case.grid.values)
    assert np.isnan(case.best((3.0, 1.0))).all()
    done.set()
    eventually(
        lambda: case.scorers.collect_answers(case.grid.values) or case.scorers.answers.choice
    )
    left, right, behind = case.best((3.0, 1.0), (3.0, -1.0), (-3.0, 0.0))
    assert left == pytest.approx(0.56, abs=0.04)  # eq. 6: S P
    assert right < 0.2
    assert np.isnan(behind)
    assert np.isnan(case.best((3.0, 1.0), target="sofa")).all()
    case.scorers.close()


def test_an_idle_service_ends_the_probation_of_another_model():
    case = Case(Scorers(None, Chooser(), value_source="choice", make_other=lambda card: Chooser()))
    swap, values = case.scorers.swap, case.grid.values
    swap.request("other")
    eventually(lambda: case.scorers.collect_answers(values) or swap.state == "on probation")
    case.scorers.collect_answers(values)
    assert swap.state == "on probation"
    case.scorers.collect_answers(values, idle=True)
    assert swap.state == "kept"
    case.scorers.close()


def test_answers_from_before_a_pose_jump_are_dropped():
    done = threading.Event()
    case = Case(Scorers(None, Chooser(done), value_source="choice"))
    case.ask(SE2(0.0, 0.0, 0.0), frontiers((3.0, 1.0)))
    case.scorers.discard_pending()
    done.set()
    eventually(lambda: case.scorers._choice.idle)
    case.scorers.collect_answers(case.grid.values)
    assert not case.grid.values.weight.any()
    case.scorers.close()


@pytest.mark.parametrize(
    ("feeds", "asked"),
    [
        ("choice", ["bed", "lamp", "bed", "sofa", "bed", "lamp"]),
        (None, ["bed"] * 6),  # the values of the others are not read
    ],
)
def test_every_target_is_asked_about_the_active_one_most(feeds, asked):
    chooser = Chooser()
    case = Case(Scorers(None, chooser, inline=True, value_source=feeds), ("sofa", "bed", "lamp"))
    for seq in range(6):
        case.ask(SE2(0.0, 0.0, 0.0), frontiers((3.0, 1.0)), seq=seq)
        case.scorers.collect_answers(case.grid.values)
    assert chooser.asked == asked
    assert case.grid.values.weight.any(axis=(0, 1)).tolist() == [feeds == "choice"] * 3


# -- scores by related objects -------------------------------------------------------------


def detections(targets=(), around=(), prompts=BOTH, observation=None) -> Detections:
    """Boxes are (word, score)."""
    words = tuple(dict.fromkeys(word for word, _ in around))

    def boxes(found, of):
        score = np.array([score for _, score in found], np.float32)
        label = np.array([of.index(word) for word, _ in found], np.int32)
        return np.zeros((len(found), 4), np.float32), score, label

    return Detections(
        observation or seen_from(SE2(0.0, 0.0, 0.0)), *boxes(targets, prompts), prompts,
        context=ContextBoxes(*boxes(around, words), words) if around else None,
    )  # fmt: skip


def test_a_view_of_nothing_promises_nothing():
    assert RelatedScores()(detections()).tolist() == [0.0, 0.0]


def test_related_objects_raise_the_score_of_a_target():
    score = RelatedScores()
    assert score(detections([("bed", 0.5)]))[0] == pytest.approx(0.5)
    p = p_object_given_word(load(), BOTH, ("pillow", "toilet", "lampion"))
    assert p[0, 0] > 0.6 > 0.05 > p[0, 1]
    assert p[:, 2].tolist() == [0.0, 0.0]  # a word of which nothing is known
    around = [("pillow", 0.8), ("toilet", 0.9), ("lampion", 1.0)]
    got = score(detections([("bed", 0.1), ("sofa", 0.9)], around))
    by_sofa = p_object_given_word(load(), BOTH, ("sofa",))[0, 0] * 0.9
    assert got == pytest.approx([max(p[0, 0] * 0.8, by_sofa), 0.9], abs=1e-6)


class Favour:
    """A prior that knows one place, near which everything is."""

    def __init__(self, x_m: float, y_m: float, lift: float) -> None:
        self.at, self.much = (x_m, y_m), lift

    def likelihood_ratio(self, target, xy_m, n, out) -> None:
        near = np.hypot(*(xy_m[:n] - np.float32(self.at)).T) < 0.5
        out[:n] = np.where(near, self.much, 1.0)


@pytest.mark.parametrize(
    ("lift", "p", "elsewhere"), [(3.0, [0.2, 0.6], 0.2), (1.0, [1 / 3] * 2, 1 / 3)]
)
def test_the_prior_chooses_as_a_model_would(lift, p, elsewhere):
    """Its share of all lifts, "elsewhere" being average; S has the odds of the best direction."""
    scorers = Scorers(None, PriorChoice(), value_source="choice")  # at once, though not inline
    case = Case(scorers)
    left, right = (3.0, 1.0), (3.0, -1.0)
    case.ask(SE2(0.0, 0.0, 0.0), frontiers(left, right), prior=Favour(*right, lift))
    scorers.collect_answers(case.grid.values)
    choice = scorers.answers.choice
    assert dict(zip(choice.ids, choice.p.tolist(), strict=True)) == pytest.approx(
        {7: p[0], 8: p[1]}
    )
    assert choice.elsewhere == pytest.approx(elsewhere)
    assert choice.scene == pytest.approx(lift / (1.0 + lift))
    assert case.best(left, right) == pytest.approx(choice.scene * np.array(p), abs=0.05)


def test_without_a_prior_it_makes_no_choice():
    scorers = Scorers(None, PriorChoice(), value_source="choice")
    case = Case(scorers)
    case.ask(SE2(0.0, 0.0, 0.0), frontiers((3.0, 1.0)))
    scorers.collect_answers(case.grid.values)
    assert scorers.answers.choice is None


# -- in the service ------------------------------------------------------------------------


RELATED = {"similarity": "cooccurrence-similarity"}
BY_PRIOR = {"choice": {"kind": "cooccurrence"}}


@pytest.mark.parametrize(
    ("policy", "perception"),
    [({"kind": "adaptive"}, RELATED), ({"kind": "adaptive", "by": "choice"}, BY_PRIOR)],
)
def test_related_objects_guide_a_robot_without_a_server(policy, perception):
    """The next mission keeps the values of a target; a pose jump clears them."""
    config = simulated(
        {
            "loop": {"lockstep": True}, "sim": {"lockstep": True, "step_s": 0.2},
            "policy": policy, "perception": perception, "mission": {"target": "television"},
        }
    )  # fmt: skip
    loop = ClosedLoop(config).run(240)
    service = loop.service
    assert service.status.phase == "reached", service.status
    values = service.map.grid.values
    assert values.value.shape[2] == 1
    said = values.value.copy()
    assert said.max() > 0
    service.begin(prepare(config.mission, "go to the bed, then to the television"), START_NS)
    assert service.mission.spec.targets == ("bed", "television")
    np.testing.assert_array_equal(values.value[..., 1:], said)
    loop.step()
    service.on_pose_jump(loop.drive.motion.stamp_ns)
    assert service.map.grid.values.value.shape[2] == 2
    assert not service.map.grid.values.weight.any()


@pytest.mark.parametrize(
    ("reaches", "others"),
    [
        ((True, True, True, True), (2.0, 1.0, 9.0)),
        ((True, True, True, False), (1.0, 6.0, 4.0)),
        ((True, True, False, False), (0.0, 0.0, 0.0)),  # none that a way leads to
    ],
)
def test_mark_costs_cover_marks_and_other_frontiers(reaches, others):
    candidates = frontiers((4.0, 1.0), (5.0, -1.0), (-6.0, 0.0), (-1.0, 0.0))
    candidates.path_m[:4] = np.where(reaches, (4.5, 7.0, 6.0, 1.0), math.inf)
    candidates.gain_m2[:4] = 2.0, 3.0, 4.0, 9.0
    marks = (Mark(8, 0.0, 0.0, 0.0, 5.0), Mark(7, 9.0, 0.0, 0.0, 4.0))
    ways = mark_costs(candidates, np.arange(4), marks)
    np.testing.assert_allclose(ways.path_m, [7.0, 4.5])
    np.testing.assert_allclose(ways.gain_m2, [3.0, 2.0])
    np.testing.assert_allclose(ways.others, others)
