from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge.config import MissionConfig, PlannerVitl
from edge.geometry import SE2
from edge.memory import Place, Site
from edge.mission.checkpoint import restore, state_of
from edge.mission.instructions import MissionError
from edge.mission.run import MissionRun, forget_places
from edge.mission.spec import prepare

S = 1_000_000_000
CHOICE = "F ((chair | sofa) & F tv) & (!bed W tv)"


def begun(formula: str = CHOICE, **settings) -> MissionRun:
    config = MissionConfig(**settings)
    mission = MissionRun(prepare(config, formula=formula), config)
    mission.start(0)
    mission.observe(SE2(0, 0, 0), 0)
    return mission


def kinds(mission: MissionRun) -> list[str]:
    return [step.kind for step in mission.log]


def test_a_new_mission_has_a_target_and_has_done_nothing():
    mission = begun()
    assert (mission.target, mission.progress.trace, mission.sets.reached) == ("chair", (), ())
    assert kinds(mission) == ["start", "target"]
    assert not mission.done
    assert mission.status("searching").phase == "searching"


def test_a_seen_branch_is_switched_to_at_once():
    """ViTL IV-A2: exploring for the chair, the robot sees the couch."""
    mission = begun()
    mission.on_detections({"sofa": 1}, S)
    assert mission.target == "sofa"
    mission.on_detections({}, 2 * S)
    assert mission.target == "sofa", "of equals, the one that is pursued"
    assert mission.sets.knowledge.detected == frozenset()
    assert kinds(mission)[2:] == ["seen", "target"]


def test_reaching_the_targets_in_order_ends_the_mission():
    mission = begun()
    mission.on_detections({"sofa": 1}, S)
    mission.on_reached("seen in 5 images", 2 * S)
    assert (mission.target, mission.progress.trace) == ("tv", ("sofa",))
    mission.on_reached("seen in 6 images", 3 * S)
    assert mission.status("searching").phase == "reached"
    assert mission.reason == "sofa, then tv"
    assert kinds(mission)[-2:] == ["reached", "end"]


def test_a_failed_branch_gives_way_to_the_other():
    mission = begun()
    mission.abandon_target("found no chair", S)
    assert (mission.target, mission.sets.failed) == ("sofa", {"chair"})
    mission.abandon_target("found no sofa", 2 * S)
    status = mission.status("searching")
    assert status.phase == "failed"
    assert "found no" in status.reason


def test_a_failed_target_is_retried_for_a_new_instance():
    mission = begun()
    mission.on_detections({"chair": 4}, S)
    mission.abandon_target("no way to it", 2 * S)
    assert mission.target == "sofa"
    mission.on_detections({"chair": 4}, 3 * S)
    assert (mission.target, mission.sets.failed) == ("sofa", {"chair"})
    mission.on_detections({"chair": 9}, 4 * S)
    assert (mission.target, mission.sets.failed) == ("chair", frozenset())


def test_a_target_failed_before_a_restart_needs_a_new_instance():
    mission = begun("F (chair | sofa)")
    config = MissionConfig()
    second = MissionRun(mission.spec, config)
    second.sets.restore((), {"chair"})
    second.start(0)
    second.sets.mark_stale_before(dict.fromkeys(second.sets.failed, 7))
    second.on_detections({"chair": 7}, S)
    assert second.sets.failed == {"chair"}
    second.abandon_target("no way to it", 2 * S)
    assert second.reason == "chair failed before the restart; no way to it"
    third = MissionRun(mission.spec, config)
    third.sets.restore((), {"chair"})
    third.start(0)
    third.sets.mark_stale_before(dict.fromkeys(third.sets.failed, 7))
    third.on_detections({"chair": 8}, S)
    assert third.target == "chair"


def test_an_empty_step_is_taken_if_the_formula_needs_one():
    mission = begun("F (chair & F (!chair & F chair))")
    mission.on_reached("", S)
    assert mission.progress.trace == ("chair", "")
    assert mission.target == "chair"
    mission.on_reached("", 2 * S)
    assert mission.done


def test_places_of_an_old_map_frame_are_given_up_in_all_rounds():
    site = Site((Place("dock", SE2(1.0, 2.0, 0.0)), Place("shelf", SE2(3.0, 2.0, 0.0))))
    config = MissionConfig()
    spec = prepare(config, formula="F dock & F (shelf | bed)", site=site)
    mission = MissionRun(spec, config)
    mission.start(0)
    forget_places(mission, S)
    assert (mission.done, mission.sets.failed) == (True, {"dock", "shelf"})
    assert "dock: its place was in the old map frame" in mission.reason
    mission.sets.begin_round()
    mission.sets.on_detections({"dock": 0, "shelf": 0, "bed": 3}, keep=False)
    assert (mission.sets.detected, mission.sets.failed) == ({"bed"}, {"dock", "shelf"})
    restarted = MissionRun(spec, config)
    restore(restarted, state_of(mission, "exploring"))
    restarted.sets.begin_round()
    assert restarted.sets.failed == {"dock", "shelf"}


def test_a_wait_goes_on_without_sensors():
    mission = begun('F "wait 1 min"', time_limit_s=10)
    for t_s in range(31):
        mission.observe(None, t_s * S, searching=False)
    mission.check_limits(31 * S)
    assert (mission.done, mission.pursued_now_s) == (False, 30.0)


@pytest.mark.parametrize(
    ("settings", "steps", "reason"),
    [
        ({"time_limit_s": 10}, [(0, 0.0), (11, 0.1)], "time limit of 10 s"),
        ({"path_limit_m": 3}, [(i, 0.4 * i) for i in range(9)], "path limit of 3 m"),
        ({"path_limit_m": 3}, [(i, 1.5 * i) for i in range(4)], "path limit of 3 m"),
        (
            {"search_limit_s": 5},
            [(i, 0.0) for i in range(20)],
            "no chair within 5 s; no sofa within 5 s",
        ),
    ],
)
def test_limits_end_a_mission_with_the_reason(settings, steps, reason):
    mission = begun("F (chair | sofa)", **settings)
    for t, x in steps:
        mission.observe(SE2(x, 0, 0), t * S)
        mission.check_limits(t * S)
    status = mission.status("searching")
    assert status.phase == "failed"
    assert reason in status.reason


@pytest.mark.parametrize("target", ["explored", "explored kitchen", "every room", "wait 1 min"])
def test_the_limits_do_not_apply_to_a_target_that_ends_by_itself(target):
    mission = begun(f'F "{target}" & F chair', time_limit_s=10, path_limit_m=3, search_limit_s=5)
    mission.on_detections({target: 1}, 0)
    assert mission.target == target
    for t in range(1, 12):
        mission.observe(SE2(0.4 * t, 0, 0), t * S)
        mission.check_limits(t * S)
    assert mission.target == target
    mission.on_reached("", 11 * S)
    for t in range(12, 18):
        mission.observe(SE2(4.4, 0, 0), t * S)
        mission.check_limits(t * S)
    assert mission.reason == "no chair within 5 s"


def test_without_sensors_the_limits_apply_to_an_exploration():
    mission = begun("F explored", time_limit_s=10)
    for t in range(1, 12):
        mission.observe(SE2(0, 0, 0), t * S, searching=False)
        mission.check_limits(t * S)
    assert mission.reason == "time limit of 10 s"


def test_time_passes_without_a_pose_but_not_while_paused():
    mission = begun(time_limit_s=10)
    mission.observe(None, 4 * S)
    mission.pause(True)
    mission.observe(None, 100 * S)
    mission.check_limits(100 * S)
    assert mission.status("searching").phase == "paused"
    mission.pause(False)
    mission.observe(None, 105 * S)
    mission.check_limits(105 * S)
    assert mission.meter.elapsed_s == pytest.approx(9)
    assert not mission.done


def test_the_end_is_final():
    mission = begun("F chair")
    mission.on_reached("confirmed", S)
    mission.finish("failed", "again", 2 * S)
    mission.on_detections({"chair": 2}, 2 * S)
    assert (mission.status("searching").phase, mission.reason) == ("reached", "confirmed")


def test_a_restored_mission_resumes_at_the_same_state():
    first = begun()
    first.on_detections({"sofa": 1}, S)
    first.on_reached("", 2 * S)
    config = MissionConfig()
    second = MissionRun(prepare(config, formula=CHOICE), config)
    restore(second, replace(state_of(first, "searching"), elapsed_s=12.0))
    second.start(0)
    assert second.progress.state == first.progress.state
    assert (second.target, second.meter.elapsed_s) == ("tv", 12.0)


@pytest.mark.parametrize("weights", ["constant", "distance"])
def test_a_fallback_begins_when_its_target_has_failed(weights):
    formula = 'F (mug & F bed) | F ("no mug" & F sofa)'
    mission = begun(formula, planner=PlannerVitl(weights=weights))
    mission.on_detections({"sofa": 1, "bed": 2}, S)
    assert mission.target == "mug"
    mission.abandon_target("explored all", 2 * S)
    assert mission.target == "sofa"
    assert [event.text for event in mission.log[-3:-1]] == [
        "failed: mug (explored all)", "no mug: goes on",
    ]  # fmt: skip
    mission.on_reached("confirmed", 3 * S)
    assert (mission.ended, mission.reason) == ("reached", "no mug, then sofa")


def test_a_target_that_is_found_has_no_fallback():
    mission = begun('F (mug & F bed) | F ("no mug" & F sofa)')
    mission.on_reached("confirmed", S)
    assert mission.target == "bed"
    mission.abandon_target("explored all", 2 * S)
    assert (mission.ended, mission.reason) == ("failed", "explored all")


def test_a_restored_mission_is_still_in_its_fallback():
    formula, config = 'F mug | F ("no mug" & F (bed & F sofa))', MissionConfig()
    first = begun(formula)
    first.abandon_target("explored all", S)
    second = MissionRun(prepare(config, formula=formula), config)
    restore(second, state_of(first, "searching"))
    second.start(0)
    assert (second.target, second.progress.trace) == ("bed", ("no mug",))


def test_a_synonym_names_the_same_failure():
    mission = begun('F couch | F ("no sofa" & F bed)')
    mission.abandon_target("explored all", S)
    assert mission.target == "bed"


def test_a_failure_that_nothing_follows_ends_the_mission():
    mission = begun('F mug | F "no mug"')
    mission.abandon_target("explored all", S)
    assert (mission.ended, mission.reason) == ("reached", "explored all")
    with pytest.raises(MissionError, match="no mug: the robot can do this, but"):
        prepare(MissionConfig(), formula='F mug & G !"no mug"')


def test_with_distances_the_nearer_branch_wins_by_the_margin():
    planner = PlannerVitl(weights="distance")
    mission = begun("F (chair | sofa)", planner=planner)
    mission.on_detections({"chair": 1, "sofa": 2}, S)
    assert mission.target == "chair"

    def survey(chair_m: float, sofa_m: float) -> str:
        between = np.array([[0, 4.0], [4.0, 0]])
        mission.sets.distance_m = np.vstack([between, [chair_m, sofa_m]])
        mission.replan(2 * S)
        return mission.target

    assert survey(5.0, 4.5) == "chair"
    assert survey(5.0, 3.5) == "sofa"
    assert survey(3.2, 3.5) == "sofa"
    assert survey(1.0, 3.5) == "chair"
