from __future__ import annotations

import numpy as np
import pytest
from lifted_boxes import lifted

from edge import config
from edge.geometry import SE2
from edge.perception.tracking.fusion import InstanceFusion
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.object_tracker import ObjectTracker


class Scene:
    """Feeds a tracker with things at known places, one frame after the other."""

    def __init__(self, make_observation, **settings):
        self.tracker = InstanceTracker(
            config.PerceptionConfig(detector=config.DetectorSim(), **settings)
        )
        self.fusion = InstanceFusion(self.tracker)
        self.make, self.seq = make_observation, 0

    def see(self, *things, x_m=0.0, y_m=0.0, depth_m=6.0, **shape):
        """One frame with (label, x, y, score) each; returns all instances."""
        self.last = seen = self.frame(x_m, y_m, depth_m)
        self.fusion.update(self.lifted(seen, things, **shape), seen.stamp_ns)
        return self.tracker.all

    @staticmethod
    def lifted(seen, things, seed=0, **shape):
        labels = [t[0] for t in sorted(things, key=lambda t: -t[3])]
        prompts = tuple(dict.fromkeys(labels)) or ("none",)
        return lifted(seen, things, prompts, seed + seen.seq - 1, **shape)

    def expire(self, observation, prompts=("chair", "desk")):
        return self.fusion.expire(observation, prompts)

    def frame(self, x_m=0.0, y_m=0.0, depth_m=6.0):
        self.seq += 1
        depth = np.full((64, 80), depth_m, np.float32)
        return self.make(seq=self.seq, x_m=x_m, y_m=y_m, depth_m=depth)


@pytest.fixture
def scene(make_observation):
    return lambda **settings: Scene(make_observation, **settings)


def test_nothing_seen_nothing_there(scene):
    s = scene()
    assert s.see() == []
    assert s.tracker.of("chair") == []
    assert s.expire(s.frame()) == []
    assert s.tracker.get(1) is None


def test_only_scores_above_tau_det_create_an_instance(scene):
    s = scene(tau_det=0.3)
    assert s.see(("chair", 2, 0, 0.29)) == []
    (chair,) = s.see(("chair", 2, 0, 0.31))
    assert (chair.label, chair.hits, chair.state) == ("chair", 1, "tentative")
    np.testing.assert_allclose(chair.center_m, [2, 0, 0.4], atol=0.1)
    assert chair.distance_m(0, 0) == pytest.approx(1.95, abs=0.1)


@pytest.mark.parametrize(
    ("second", "count"),
    [(("chair", 2.4, 0, 0.6), 1), (("chair", 4.0, 0, 0.6), 2), (("sofa", 2.1, 0, 0.6), 2)],
    ids=["near", "far", "another label"],
)
def test_nearby_boxes_of_a_class_merge(scene, second, count):
    s = scene(merge_m=0.6)
    s.see(("chair", 2, 0, 0.6))
    assert len(s.see(second)) == count


@pytest.mark.parametrize(
    ("other", "images", "count", "apart"),
    [
        (("chair", 2, 0.25, 0.5), 3, 1, [set()]),  # parts that touch
        (("chair", 2, 0.55, 0.5), 2, 1, [set(), set()]),
        (("chair", 2, 0.55, 0.5), 3, 2, [{2}, {1}]),
        (("sofa", 2, 0.55, 0.5), 3, 2, [set(), set()]),
    ],
    ids=["no gap", "few images", "a gap", "another label"],
)
def test_boxes_with_a_gap_in_one_image_are_two_objects(scene, other, images, count, apart):
    s = scene(merge_m=0.6)
    for _ in range(images):
        s.see(("chair", 2, 0, 0.6), other)
    assert [one.apart for one in s.tracker.all] == apart
    for y_m in (0, other[2], 0.5 * other[2]) * 4:  # later images show one of them, or both as one
        s.see(("chair", 2, y_m, 0.6))
    assert len(s.tracker) == count
    copy = InstanceTracker(s.tracker.config)
    copy.load_state_dict(s.tracker.state_dict(), 0)
    assert [one.apart for one in copy.all] == [one.apart for one in s.tracker.all]


def test_two_boxes_that_touch_are_one_object(scene):
    """The surfaces are of the inner part of each box, so there is a gap between them."""
    s = scene(merge_m=0.6)
    for _ in range(4):
        s.see(("sofa", 2, 0, 0.6), ("sofa", 2, 0.6, 0.5), size_m=0.25)
    assert [one.apart for one in s.tracker.all] == [set()]


def test_a_gap_to_an_object_is_kept_when_that_merges(scene):
    s = scene(merge_m=0.6)
    for x_m in (0.0, 0.25, 0.5):
        points_m = np.float32([[x_m, 0.0, 0.0], [x_m, 0.05, 0.0]])
        s.tracker.create("chair", points_m, 0.9, 0)
    one, two, three = s.tracker.all
    two.apart, three.apart = frozenset({3}), frozenset({2})
    for number in (2, 3):
        s.fusion._merge_overlapping(number)
    assert s.tracker.all == [one, three]
    assert (one.apart, three.apart) == ({3}, {1})


def test_an_instance_that_its_last_view_rejects_is_not_forgotten(scene):
    s = scene()
    s.see(("chair", 2, 0, 0.9))
    (track,) = s.tracker.tracks.values()
    track.views, track.target_sum, track.competing_sum = 29.5, 5.0, 9.0
    track.instance.score = 0.155  # one view without a box more, and it would be forgotten
    s.expire(s.frame())
    assert [one.state for one in s.tracker.all] == ["rejected"]


def test_objects_that_are_apart_are_never_merged(scene):
    s = scene(merge_m=1.0)
    for _ in range(3):
        s.see(("sofa", 2.0, 0, 0.6), ("sofa", 3.6, 0, 0.5))
    for _ in range(12):
        s.see(("sofa", 2.9, 0, 0.6), size_m=0.8)
    assert len(s.tracker) == 2


def test_gaps_are_forgotten_with_their_objects(scene):
    s = scene(merge_m=0.6)
    s.see(("chair", 2, 0, 0.6), ("chair", 2, 0.55, 0.5))
    assert s.fusion._seen_apart == {(1, 2): 1}
    s.tracker.clear()
    s.see()
    assert not s.fusion._seen_apart


def test_two_boxes_at_a_rejected_object_start_no_other(scene):
    s = scene(merge_m=0.6)
    s.see(("chair", 2, 0, 0.6))
    s.tracker.reject(1)
    for _ in range(4):
        s.see(("chair", 2, 0, 0.6), ("chair", 2, 0.5, 0.6))
    assert [one.state for one in s.tracker.all] == ["rejected"]


def test_instances_that_grow_together_become_one(scene):
    s = scene(merge_m=1.0)
    s.see(("sofa", 2.0, 0, 0.6))
    s.see(("sofa", 3.6, 0, 0.5))
    assert len(s.tracker) == 2
    for _ in range(12):
        s.see(("sofa", 2.9, 0, 0.6), size_m=0.8)
    assert [i.id for i in s.tracker.all] == [1]


@pytest.mark.parametrize(
    ("score", "x_m", "hits", "state"),
    [
        (0.5, 2.0, 3, "confirmed"),
        (0.5, 2.0, 2, "tentative"),
        (0.32, 2.0, 9, "tentative"),
        (0.5, 4.0, 9, "tentative"),
    ],
    ids=["well", "too seldom", "too weakly", "from too far"],
)
def test_confirmation(scene, score, x_m, hits, state):
    s = scene(confirm_hits=3, confirm_score=0.35, confirm_range_m=3.0)
    for _ in range(hits):
        (chair,) = s.see(("chair", x_m, 0, score))
    assert chair.state == state
    assert chair.is_confirmed is (state == "confirmed")


@pytest.mark.parametrize(
    ("x_m", "z_m", "state"),
    [(4.0, 0.4, "tentative"), (4.0, 2.3, "confirmed"), (7.0, 2.3, "tentative")],
    ids=["in view from near by", "too high for that", "too far"],
)
def test_a_high_object_is_confirmed_from_farther_away(scene, x_m, z_m, state):
    s = scene(confirm_hits=3, confirm_range_m=3.0)
    for _ in range(3):
        (painting,) = s.see(("painting", x_m, 0, 0.5), z_m=z_m)
        s.expire(s.last)
    assert painting.state == state


def test_a_detection_counts_as_a_view_if_partly_hidden(scene):
    s = scene(confirm_hits=3, confirm_mean=0.3, tau_det=0.01)
    (plant,) = s.see(("chair", 2, 0, 0.6))
    for _ in range(9):
        s.expire(s.frame())
    for _ in range(40):
        s.see(("chair", 2, 0, 0.6), depth_m=1.0)
        s.expire(s.last)
    assert plant.state == "confirmed"


@pytest.mark.parametrize(
    ("places", "at", "verified"),
    [
        ([(0, 0)] * 4, (0, 0), True),  # the robot was nowhere else
        ([(0, 0)] * 40, (0.6, 0), False),
        ([(0, 0)] * 3 + [(0.6, 0)], (0.6, 0), False),
        ([(0, 0)] * 2 + [(0.6, 0)] * 2, (0.6, 0), True),
        ([(0, 0)] * 2 + [(0.4, 0)] * 2, (0.6, 0), False),
        ([(1.4, 0.2)] * 2 + [(1.4, -0.2)] * 2, (1.4, -0.2), True),  # 37 degrees around it
        ([(0, 0)] * 2 + [(0.6, 0)], (0.6, 0), False),  # too seldom: not confirmed
    ],
)
def test_a_confirmed_object_is_verified_by_hits_from_another_viewpoint(scene, places, at, verified):
    s = scene(confirm_hits=4)
    for x_m, y_m in places:
        (chair,) = s.see(("chair", 2, 0, 0.6), x_m=x_m, y_m=y_m)
    assert s.tracker.verified(chair, SE2(*at, 0.0)) == verified


@pytest.mark.parametrize(
    ("places_m", "viewpoint"),
    [
        ([0.2] * 3, None),  # not confirmed
        ([0.2] * 4, (0.2, 0.0)),
        ([0.2, 0.4, 0.4, 0.8], (0.2, 0.0)),
        ([0.2, 0.2, 0.8, 0.8], None),
    ],
)
def test_the_only_viewpoint_of_a_confirmed_object(scene, places_m, viewpoint):
    s = scene(confirm_hits=4)
    for x_m in places_m:
        s.see(("chair", 2, 0, 0.6), x_m=x_m)
    assert s.tracker.tracks[1].only_viewpoint(4) == viewpoint


@pytest.mark.parametrize(("x_m", "verified"), [(0.0, False), (0.6, True)])
def test_a_fallen_score_needs_another_viewpoint(scene, x_m, verified):
    s = scene(confirm_hits=4, confirm_score=0.5)
    for at_m in (0.0, 0.0, x_m, x_m):
        s.see(("chair", 2, 0, 0.6), x_m=at_m)
    for _ in range(4):
        (chair,) = s.see(("chair", 2, 0, 0.3), x_m=x_m)
    assert (chair.is_confirmed, chair.score < 0.5) == (True, True)
    assert s.tracker.verified_now(chair, SE2(x_m, 0.0, 0.0)) == verified


def test_merged_objects_keep_the_viewpoint_of_their_hits(scene):
    s = scene(confirm_hits=4, merge_m=1.0, confirm_score=0.5)
    s.see(("sofa", 1.5, 0, 0.4))  # the older one has no good hit
    for _ in range(3):
        s.see(("sofa", 2.9, 0, 0.6))
    assert len(s.tracker) == 2
    for _ in range(12):
        s.see(("sofa", 2.5, 0, 0.6), size_m=0.6)
    (sofa,) = s.tracker.all
    assert (sofa.id, sofa.state) == (1, "confirmed")
    assert not s.tracker.verified(sofa, SE2(0.6, 0.0, 0.0))


def test_repeated_misses_undo_a_confirmation(scene):
    s = scene(confirm_hits=3, confirm_mean=0.3, tau_det=0.01)
    for _ in range(3):
        (chair,) = s.see(("chair", 2, 0, 0.6))
    assert chair.state == "confirmed"
    for _ in range(15):
        s.expire(s.frame())
    assert chair.state == "tentative"


def test_a_stronger_competing_class_rejects_an_instance(scene):
    s = scene(confirm_hits=3, tau_det=0.1)
    (desk,) = s.see(("desk", 2, 0, 0.6))
    for _ in range(40):
        s.see(("desk", 2, 0, 0.45), competing_score=0.7)
        s.expire(s.last)
    assert desk.state == "rejected"
    assert s.tracker.of("desk") == []


@pytest.mark.parametrize("places", ["under the nose", "at the rim"])
def test_mistakes_in_partial_views_do_not_confirm(scene, places):
    """Looks in vain count there too, if less: mistakes alone would else make their own mean."""
    x_m, y_m = {"under the nose": (0.75, 0.0), "at the rim": (2.0, 1.4)}[places]
    s = scene(confirm_hits=3, confirm_mean=0.12, tau_det=0.1)
    for _ in range(4):
        (chair,) = s.see(("chair", x_m, y_m, 0.4))
        s.expire(s.last)
        for _ in range(19):
            s.expire(s.frame())
    assert chair.state == "tentative"
    for _ in range(40):
        s.see(("chair", x_m, y_m, 0.4))
        s.expire(s.last)
    assert chair.state == "confirmed"


def test_a_rejected_object_is_never_pursued_again(scene):
    s = scene(min_hits=1)
    (chair,) = s.see(("chair", 2, 0, 0.6))
    s.tracker.reject(chair.id)
    for _ in range(5):
        s.see(("chair", 2.3, 0.2, 0.9))
    assert len(s.tracker) == 1
    assert chair.state == "rejected"
    assert s.tracker.of("chair") == []
    s.see(("chair", 4, 0, 0.6))
    assert [i.id for i in s.tracker.of("chair")] == [2]
    s.expire(s.frame())
    assert s.tracker.get(chair.id) is chair


def test_rejecting_an_object_removes_its_duplicates(scene):
    s = scene(merge_m=0.3)
    s.see(("chair", 2, 0, 0.6), ("chair", 2.5, 0, 0.6), ("sofa", 2.3, 0, 0.6))
    s.tracker.reject(1)
    assert [(i.label, i.state) for i in s.tracker.all] == [
        ("chair", "rejected"),
        ("sofa", "tentative"),
    ]


@pytest.mark.parametrize(
    ("x_m", "y_m", "depth_m"),
    [(8.0, 0.0, 6.0), (2.0, 5.0, 6.0), (0.3, 0.0, 6.0), (3.0, 0.0, 1.0), (-3.0, 0.0, 6.0)],
    ids=["too far", "beside", "under the nose", "hidden", "behind"],
)
def test_an_instance_out_of_view_keeps_its_score(scene, x_m, y_m, depth_m):
    s = scene(back_projection_max_range_m=8.0)
    (chair,) = s.see(("chair", x_m, y_m, 0.6))
    for _ in range(50):
        s.expire(s.frame(depth_m=depth_m))
    assert chair.score == pytest.approx(0.6)


def test_the_weakest_instances_are_dropped_unless_protected(scene, monkeypatch):
    monkeypatch.setattr("edge.perception.tracking.instances.MAX_INSTANCES", 2)
    s = scene()
    s.see(("chair", 2, 0, 0.4))
    s.tracker.reject(1)
    s.see(("chair", 2, 4, 0.5), ("chair", 2, -4, 0.9), ("chair", 5, 0, 0.6))
    assert [i.id for i in s.tracker.all] == [1, 2]
    assert s.tracker.get(2).score == pytest.approx(0.9)


def test_a_search_for_another_target_lowers_no_score(scene):
    s = scene(confirm_hits=3)
    for _ in range(3):
        (chair,) = s.see(("chair", 2, 0, 0.6))
    before = chair.score
    for _ in range(60):
        s.expire(s.frame(), ("sofa",))
    assert (chair.state, chair.score) == ("confirmed", before)
    assert s.expire(s.frame(), ("sofa", "chairs")) == []
    assert chair.score < before


def test_another_mission_can_find_reached_and_rejected_objects_again(scene):
    s = scene(min_hits=1)
    s.see(("chair", 2, 0, 0.6), ("sofa", 4, 0, 0.6), ("desk", 6, 0, 0.6))
    s.tracker.mark_reached(1)
    s.tracker.reject(2)
    s.tracker.forget_verdicts()
    assert [(i.label, i.state) for i in s.tracker.all] == [
        ("chair", "confirmed"),
        ("desk", "tentative"),
    ]
    s.see(("sofa", 4, 0, 0.6))
    assert [i.state for i in s.tracker.of("sofa")] == ["tentative"]


def test_rejected_objects_of_the_target_can_be_found_again(scene):
    s = scene(min_hits=1)
    s.see(("couch", 2, 0, 0.6), ("chair", 4, 0, 0.6))
    s.tracker.reject(1)
    s.tracker.reject(2)
    s.tracker.forget_rejected("sofa")
    assert [(i.label, i.state) for i in s.tracker.all] == [("chair", "rejected")]


class Memory(Scene):
    """A scene whose tracker remembers context objects."""

    def __init__(self, make_observation, **settings):
        super().__init__(make_observation, **settings)
        self.sightings = ObjectTracker(self.tracker.config)
        self.fusion = InstanceFusion(self.tracker, self.sightings)

    def look(self, *things, around=()):
        """One frame with targets, and with context words likewise."""
        seen = self.frame()
        lifted = self.lifted(seen, things)
        self.sightings.update(lifted, self.lifted(seen, around))
        self.fusion.update(lifted, seen.stamp_ns)
        self.expire(seen)
        return self.tracker


@pytest.fixture
def memory(make_observation):
    return lambda **settings: Memory(make_observation, **settings)


@pytest.mark.parametrize(
    ("first", "competing_score", "state"),
    [(0, 0.5, "tentative"), (6, 0.5, "confirmed"), (6, 0.9, "tentative")],
    ids=["never confirmed", "confirmed before", "confirmed before, but another does better"],
)
def test_a_confirmed_instance_stays_until_a_competitor_leads(scene, first, competing_score, state):
    s = scene(confirm_lead=2.0)
    for k in range(first + 20):
        (chair,) = s.see(
            ("chair", 2, 0, 0.6), competing_score=0.0 if k < first else competing_score
        )
        s.expire(s.last)
    assert chair.state == state


@pytest.mark.parametrize(
    ("scores", "at", "state"),
    [
        ({}, 0.6, "confirmed"),
        ({"office chair": 0.7}, 0.6, "tentative"),  # the canonical name is chair
        ({"office chair": 0.7}, 0.75, "confirmed"),
        ({"desk": 0.7}, 0.6, "confirmed"),
        ({"chair": 1.0}, 0.99, "tentative"),
    ],
)
def test_a_word_has_a_score_of_its_own(scene, scores, at, state):
    s = scene(confirm_scores=scores)
    for _ in range(10):
        (chair,) = s.see(("chair", 2, 0, at))
        s.expire(s.last)
    assert chair.state == state


def test_a_surer_competing_object_prevents_confirmation(memory):
    s = memory()
    for _ in range(10):
        s.look(around=[("sofa", 2, 0, 0.7)])
    for _ in range(4):
        tracker = s.look(("desk", 2, 0, 0.5), around=[("sofa", 2, 0, 0.7)])
    (desk,) = tracker.of("desk")
    assert desk.state == "tentative"
    assert tracker.of("desk", with_contested=False) == []
    for _ in range(60):  # it was a mistake, and as the looks go on it is seen to be one
        s.look(("desk", 2, 0, 0.6), around=[("sofa", 2, 3, 0.7)])
    assert tracker.of("desk", only_confirmed=True, with_contested=False) == [desk]


@pytest.mark.parametrize(
    ("first", "desk_score", "sofa_score", "sure"),
    [(0, 0.5, 0.7, False), (20, 0.5, 0.7, True), (20, 0.1, 0.9, False)],
    ids=["never confirmed", "confirmed before", "confirmed before, but far surer another"],
)
def test_a_confirmed_instance_tolerates_a_moderate_competitor(
    memory, first, desk_score, sofa_score, sure
):
    s = memory()
    for _ in range(first):
        s.look(("desk", 2, 0, 0.6), around=[("lamp", 2, 3, 0.7), ("sofa", 2, 3, 0.7)])
    for _ in range(80):
        tracker = s.look(("desk", 2, 0, desk_score), around=[("sofa", 2, 0, sofa_score)])
    assert bool(tracker.of("desk", only_confirmed=True, with_contested=False)) == sure


@pytest.mark.parametrize(
    ("x_m", "sofa_score", "is_candidate"),
    [(4.2, 0.6, True), (4.2, 0.95, False), (2.0, 0.6, False)],
    ids=["from afar", "from afar, but far surer another", "from near by"],
)
def test_a_distant_contested_object_stays_a_candidate(memory, x_m, sofa_score, is_candidate):
    s = memory(confirm_range_m=3.0)
    for _ in range(10):
        tracker = s.look(("desk", x_m, 0, 0.5), around=[("sofa", x_m, 0, sofa_score)])
    assert bool(tracker.of("desk", with_contested=False)) == is_candidate


@pytest.mark.parametrize(
    ("word", "looks", "states"),
    [
        ("desk", 5, ["confirmed"]),
        ("writing desk", 5, ["confirmed"]),
        ("desk", 1, []),  # once is too seldom
        ("sofa", 5, []),
        ("table", 5, []),  # a table need not be a desk
    ],
)
def test_context_objects_are_promoted_to_targets(memory, word, looks, states):
    s = memory()
    for _ in range(looks):
        s.look(around=[(word, 2, 0, 0.6)])
    assert s.tracker.all == []
    s.fusion.promote_context(["desk", "chair"])
    assert [instance.state for instance in s.tracker.of("desk")] == states
    s.fusion.promote_context(["desk", "chair"])  # once is enough
    assert len(s.tracker.all) == len(states)
    for instance in s.tracker.all:
        assert instance.distance_m(2, 0) < 0.2
        assert instance.hits == looks


@pytest.mark.parametrize(("score", "state"), [(0.55, "confirmed"), (0.65, "tentative")])
def test_the_class_threshold_decides_on_a_promoted_object(memory, score, state):
    s = memory(confirm_scores={"desk": score})
    for _ in range(5):
        s.look(around=[("desk", 2, 0, 0.6)])
    s.fusion.promote_context(["desk"])
    assert [instance.state for instance in s.tracker.of("desk")] == [state]


def test_without_a_memory_nothing_is_recalled(scene):
    s = scene()
    s.fusion.promote_context(["desk"])
    assert s.tracker.all == []
