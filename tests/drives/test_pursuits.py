"""Routines in a simulated house: wait, check, explore for a time, come to the caller."""

from __future__ import annotations

import re
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from small_house import driven, small_house

from edge.bus.verbs import Request
from edge.config import MissionConfig, TranslatorGrammar
from edge.errors import UserError
from edge.geometry import SE2
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.requests.handlers import handle_mission, mission_verbs
from edge.memory import Place, RoomName, Site, Zone
from edge.mission.repetition import Repetition
from edge.mission.spec import prepare
from edge.perception.tracking.fusion import InstanceFusion
from edge.types import Instance

S = 1_000_000_000


def loop_of(
    folder: Path, formula: str, perception: dict | None = None, **mission: object
) -> ClosedLoop:
    section = {"instruction": formula, "translator": {"kind": "ltl"}, **mission}
    camera = {"width_px": 160, "height_px": 128}
    config = small_house(
        folder, loop={"lockstep": True}, sim={"lockstep": True, "step_s": 0.2},
        sensors={"camera": camera}, mission=section, perception=perception or {},
    )  # fmt: skip
    return ClosedLoop(config, colour=False)


def ask(loop: ClosedLoop, do: str) -> dict:
    return handle_mission(loop.service, Request(do), loop.drive.motion.stamp_ns)


def steps(loop: ClosedLoop, seconds: float) -> None:
    until_ns = loop.drive.motion.stamp_ns + int(seconds * S)
    while loop.drive.motion.stamp_ns < until_ns:
        loop.step()


def test_the_robot_waits_for_the_given_time_without_moving(tmp_path):
    loop = loop_of(tmp_path, 'F "wait 3 s"')
    steps(loop, 1.5)
    status = loop.service.status
    assert (status.phase, status.reason) == ("waiting", "waiting, 2 s left")
    loop.run(10)
    assert loop.service.status.phase == "reached"
    assert loop.service.status.reason == "waited 3 s"
    assert loop.seconds < 5
    assert not [goal for goal in loop.notes.goals if goal.kind != "spin"]


def test_the_robot_waits_until_a_time_of_day_in_each_round(tmp_path):
    loop = loop_of(tmp_path, "F start", time_limit_s=2.0)
    begin_ns = loop.drive.motion.stamp_ns
    soon = datetime.fromtimestamp(begin_ns // S) + timedelta(minutes=1)
    spec = prepare(
        loop.service.config.mission, formula=f'F ("wait until {soon:%H:%M}" & F start)',
        repeat=Repetition(),
    )  # fmt: skip
    loop.service.begin(spec, begin_ns)
    steps(loop, 1.0)
    text = rf"round 1; waiting until {soon:%H:%M}, (1 min|\d\d? s) left"
    assert re.fullmatch(text, loop.service.status.reason)
    ends_s = int(soon.replace(second=0).timestamp())
    while loop.service.mission.progress.round == 1:
        loop.step()
    now_s = loop.drive.motion.stamp_ns * 1e-9
    assert ends_s <= now_s < ends_s + 5
    steps(loop, 1.0)
    text = rf"round 2; waiting until {soon:%H:%M}, (23 h 5\d min|24 h) left"
    assert re.fullmatch(text, loop.service.status.reason)


def test_a_wait_without_a_time_ends_on_request(tmp_path):
    loop = loop_of(tmp_path, "F (wait & F start)", time_limit_s=2.0)
    steps(loop, 4.0)
    assert loop.service.status.reason == "waiting until told to go on"
    ask(loop, "pause")
    steps(loop, 0.5)
    ask(loop, "resume")
    steps(loop, 0.5)
    assert loop.service.status.reason == "waiting until told to go on"
    ask(loop, "resume")
    loop.step()
    assert "reached: wait (told to go on)" in loop.notes.events
    assert loop.service.mission.target == "start"


def test_exploring_ends_after_its_time_and_lists_the_objects(tmp_path):
    loop = loop_of(tmp_path, 'F "explored for 6 s"', time_limit_s=3.0).run(60)
    status = loop.service.status
    assert status.phase == "reached", status
    assert re.fullmatch(r"\d+ m² are known, found: .*\w", status.reason)
    assert 6.0 <= status.elapsed_s < 7.0


def test_an_order_with_a_period_waits_between_its_rounds(tmp_path):
    loop = driven("go to the bed every 5 seconds for 30 seconds", folder=tmp_path, seconds=60.0)
    status, waits = loop.service.status, loop.notes.events.count("reached: wait 5 s (waited 5 s)")
    assert (status.phase, waits >= 2) == ("reached", True), loop.notes.events
    assert 30.0 <= status.elapsed_s < 31.0


def test_a_check_looks_and_answers_yes_with_the_place(tmp_path):
    loop = loop_of(tmp_path, 'F ("check bed" & F here)').run(200)
    status = loop.service.status
    assert status.phase == "reached", status
    found = re.fullmatch(
        r"yes, there is a bed in .*room.* at \((.+), (.+)\), .* m away", status.reason
    )
    assert found, status.reason
    at_m = float(found[1]), float(found[2])
    assert min(o.distance_m(*at_m) for o in loop.world.objects if o.label == "bed") < 0.5


def test_a_check_for_an_absent_object_answers_no(tmp_path):
    status = loop_of(tmp_path, 'F "check surfboard"').run(280).service.status
    assert status.phase == "reached", status
    assert status.reason.startswith("no, there is no surfboard: explored all reachable space")


def test_a_check_looks_again_at_the_remembered_place(tmp_path):
    loop = loop_of(tmp_path, 'F "check piano"')
    at_m = np.array([6.5, 3.2, 0.5], np.float32)
    points_m = at_m + np.float32([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0.1]])
    piano = Instance(0, "piano", at_m, points_m, 0.9, 50, 1, 2, "confirmed")
    loop.service.map.tracker.add(piano)
    status = loop.run(150).service.status
    assert status.phase == "reached", status
    assert status.reason.startswith("no, there is no piano: explored all reachable space")
    kinds = [goal.kind for goal in loop.notes.goals]
    assert "instance" in kinds
    assert loop.service.map.tracker.of("piano", only_confirmed=True) == []


NAMED = Site((RoomName("workshop", (2.0, 2.0)), RoomName("bedroom", (6.0, 2.0))))


def in_rooms(folder: Path, formula: str) -> ClosedLoop:
    """Return a loop in the small house whose two rooms have names."""
    loop = loop_of(folder, "F start")
    loop.service.change_site(NAMED, loop.drive.motion.stamp_ns)
    spec = prepare(loop.config.mission, formula=formula, site=NAMED)
    loop.service.begin(spec, loop.drive.motion.stamp_ns)
    return loop


def test_exploring_a_room_stays_inside_and_lists_its_objects(tmp_path):
    loop = in_rooms(tmp_path, 'F "explored workshop"').run(100)
    status = loop.service.status
    assert status.phase == "reached", status
    assert re.fullmatch(r"workshop: 1\d m² are known, found: .*sofa.*", status.reason)
    assert "bed" not in status.reason
    assert all(goal.pose.x_m < 4.3 for goal in loop.notes.goals)


@pytest.mark.parametrize(
    ("formula", "answer"),
    [
        ('F "check sofa in workshop"', "yes, there is a sofa in the workshop at \\("),
        ('F "check bed in workshop"', "no, there is no bed in the workshop: the room is explored"),
        ('F "check bed in bedroom"', "yes, there is a bed in the bedroom at \\("),
    ],
)
def test_a_check_in_a_room_looks_only_there(formula, answer, tmp_path):
    status = in_rooms(tmp_path, formula).run(150).service.status
    assert status.phase == "reached", status
    assert re.match(answer, status.reason), status.reason


@pytest.mark.parametrize(
    ("formula", "answer"),
    [
        ('F "every sofa"', r"found 1 sofa( \(.*\))?: in the workshop at \(\S+, \S+\)$"),
        ('F "every bed in workshop"', "found no bed$"),
        ('F "every bed in bedroom"', r"found 1 bed( \(.*\))?: in the bedroom at "),
    ],
)
def test_all_objects_of_a_name_are_counted(formula, answer, tmp_path):
    status = in_rooms(tmp_path, formula).run(150).service.status
    assert status.phase == "reached", status
    assert re.match(answer, status.reason), status.reason


def test_a_room_that_is_not_there_is_the_reason_of_the_failure(tmp_path):
    status = in_rooms(tmp_path, 'F "every bed in kitchen"').run(150).service.status
    assert status.phase == "failed", status
    assert re.match("explored all reachable space.*, found no kitchen$", status.reason), status


def test_a_room_that_gets_another_name_meanwhile_is_still_counted(tmp_path):
    den, later = (Site((RoomName(name, (2.0, 2.0)),)) for name in ("den", "library"))
    loop = loop_of(tmp_path, "F start")
    loop.service.change_site(den, loop.drive.motion.stamp_ns)
    spec = prepare(loop.config.mission, formula='F "every sofa in den"', site=den)
    loop.service.begin(spec, loop.drive.motion.stamp_ns)
    while "exploring" not in loop.service.status.reason and not loop.service.status.done:
        loop.step()
    loop.service.change_site(later, loop.drive.motion.stamp_ns)
    loop.run(120)
    assert loop.service.status.reason.startswith("found 1 sofa"), loop.service.status


def test_each_round_counts_all_objects_again(tmp_path):
    loop = loop_of(tmp_path, 'F "every sofa"', time_limit_s=2.0)
    spec = prepare(loop.config.mission, formula='F "every sofa"', repeat=Repetition(2))
    loop.service.begin(spec, loop.drive.motion.stamp_ns)
    status = loop.run(150).service.status
    assert status.reason.count("found 1 sofa") == 2, status
    texts = [event.text for event in loop.service.mission.log]
    assert sum("found: sofa at" in text for text in texts) == 2, texts


@pytest.mark.parametrize(("obj", "phase"), [("sofa", "reached"), ("bed", "failed")])
def test_an_object_in_a_named_room_is_searched_for_only_there(obj, phase, tmp_path):
    den = Site((RoomName("den", (2.0, 2.0)),))
    loop = loop_of(tmp_path, "F start")
    loop.service.change_site(den, loop.drive.motion.stamp_ns)
    brief = prepare(loop.config.mission, formula=f'F "{obj} in the den"', site=den)
    loop.service.begin(brief, loop.drive.motion.stamp_ns)
    loop.run(120)
    assert loop.service.status.phase == phase, loop.service.status


@pytest.mark.parametrize(
    ("said", "end"),
    [
        ("look for the bed in the workshop, and if it's not there look in the bedroom",
         "no bed in the workshop, then bed in the bedroom"),
        ("if you can't find the sofa in the workshop, go to the bedroom", "confirmed, seen in"),
        ("is there a bed in the workshop? If so, go to it",
         "no bed in the workshop: the room is explored"),
    ],
)  # fmt: skip
def test_a_fallback_is_pursued_after_the_failure_only(said, end, tmp_path):
    loop = in_rooms(tmp_path, "F start")
    spec = prepare(MissionConfig(translator=TranslatorGrammar()), said, site=NAMED)
    loop.service.begin(spec, loop.drive.motion.stamp_ns)
    loop.run(200)
    status, log = loop.service.status, loop.service.mission.log
    assert status.phase == "reached", (status, loop.notes.events)
    assert status.reason.startswith(end), status.reason
    assert log[0].text.startswith(f"mission: {spec.translation.english} [F ")
    failed = [event.stamp_ns for event in log if event.kind == "failed"]
    before = [one for one in loop.notes.goals if not failed or one.stamp_ns < failed[0]]
    assert before
    assert all(goal.pose.x_m < 4.3 for goal in before)


def test_an_object_in_a_known_room_is_reached_before_its_fallback(tmp_path):
    loop = in_rooms(tmp_path, "F (explored & F start)").run(200)  # it starts inside that room
    formula = 'F "sofa in the workshop" | F ("no sofa in the workshop" & F bedroom)'
    spec = prepare(loop.config.mission, formula=formula, site=NAMED)
    loop.service.begin(spec, loop.drive.motion.stamp_ns)
    loop.run(200)
    status = loop.service.status
    assert (status.phase, status.target) == ("reached", "sofa in the workshop"), status


def test_a_closed_room_has_a_fallback(tmp_path):
    loop = loop_of(tmp_path, "F start")
    corners_m = ((4.2, -1.0), (9.0, -1.0), (9.0, 5.0), (4.2, 5.0))
    site = NAMED.with_item(Zone("closed", "keep_out", corners_m))
    loop.service.change_site(site, loop.drive.motion.stamp_ns)
    spec = prepare(loop.config.mission, formula='F bedroom | F ("no bedroom" & F start)', site=site)
    loop.service.begin(spec, loop.drive.motion.stamp_ns)
    loop.run(200)
    status = loop.service.status
    assert (status.phase, status.reason) == ("reached", "no bedroom, then start"), status


def test_a_failed_check_reports_the_last_known_place(tmp_path):
    loop = in_rooms(tmp_path, 'F "check bed in bedroom"').run(100)
    assert loop.service.status.reason.startswith("yes")
    formula, now_ns = 'F "check bed in workshop"', loop.drive.motion.stamp_ns
    loop.service.begin(prepare(loop.config.mission, formula=formula, site=NAMED), now_ns)
    reason = loop.run(200).service.status.reason
    assert reason.startswith("no, there is no bed in the workshop: the room is explored; seen ")
    assert "before: bed: in the bedroom, at (" in reason


def test_the_robot_patrols_rooms(tmp_path):
    loop = in_rooms(tmp_path, "G F workshop & G F bedroom")
    steps(loop, 60.0)
    assert loop.service.mission.progress.round >= 2, loop.notes.events


def test_the_robot_drives_to_the_caller(tmp_path):
    config = loop_of(tmp_path, "F start").config.mission
    fields = mission_verbs(prepare)["new"].read({"formula": "F caller", "from_pose": [3, 2, 1.5]})
    assert fields["caller"] == SE2(3.0, 2.0, 1.5)
    with pytest.raises(UserError, match="caller: the request does not say where the caller is"):
        prepare(config, formula="F caller")
    loop = loop_of(tmp_path, "F start")
    loop.service.begin(prepare(config, formula="F caller", caller=SE2(3.0, 2.0, 1.5)), 0)
    loop.run(100)
    assert loop.service.status.phase == "reached"
    assert loop.drive.motion.pose.distance_to(3.0, 2.0) < 0.8


def test_a_timed_patrol_reports_its_round(tmp_path):
    loop = loop_of(tmp_path, "F start")
    site = Site((Place("dock", SE2(3.0, 2.0, 0.0)), Place("shelf", SE2(1.5, 1.0, 0.0))))
    fields = mission_verbs(prepare)["new"].read({"formula": "F (dock & F shelf)", "for_s": 40})
    repeat = fields["repeat"]
    formula, now_ns = fields["formula"], loop.drive.motion.stamp_ns
    spec = prepare(loop.config.mission, formula=formula, repeat=repeat, site=site)
    loop.service.begin(spec, now_ns)
    steps(loop, 20.0)
    assert re.fullmatch(r"round [23], \d\d s left", loop.service.status.reason)
    loop.run(60.0)
    status = loop.service.status
    assert status.phase == "reached"
    assert re.fullmatch(r"[345] rounds done", status.reason)
    assert status.elapsed_s == pytest.approx(40.0, abs=0.5)


NEVER_SURE = {"confirm_mean": 0.99}  # the bed is seen well, but never confirmed


@pytest.mark.parametrize(
    ("probable", "phase", "reason"),
    [
        ("refuse", "failed", "explored all reachable space"),
        ("accept", "reached", r"probably, 0\.\d\d: bed$"),
        ("ask", "failed", r"probably, 0\.\d\d: bed; not confirmed within 60 s$"),
    ],
)
def test_an_unconfirmed_object_is_handled_as_configured(probable, phase, reason, tmp_path):
    status = loop_of(tmp_path, "F bed", NEVER_SURE, probable=probable).run(250).service.status
    assert status.phase == phase, status
    assert re.match(reason, status.reason), status.reason


@pytest.mark.parametrize(
    "limit", [{"path_limit_m": 6.0}, {"time_limit_s": 25.0}, {"search_limit_s": 25.0}]
)
def test_a_probable_object_is_visited_before_a_limit(limit, tmp_path):
    status = (
        loop_of(tmp_path, "F bed", NEVER_SURE, probable="accept", **limit).run(60).service.status
    )
    assert status.phase == "reached", status
    assert re.match(r"probably, 0\.\d\d: bed$", status.reason), status.reason


def test_a_doubted_object_is_looked_at_before_a_limit_ends_the_search(monkeypatch, tmp_path):
    def contest(fusion: InstanceFusion, track: object) -> bool:
        track.contested = True
        return True

    monkeypatch.setattr(InstanceFusion, "_update_contested", contest)
    loop = loop_of(tmp_path, "F bed", probable="accept", path_limit_m=6.0)
    status = loop.run(60).service.status
    assert status.phase == "reached", (status, loop.notes.events)
    assert re.match(r"probably, 0\.\d\d: bed$", status.reason), status.reason


@pytest.mark.parametrize(("beyond_m", "phase"), [(0.3, "reached"), (20.0, "failed")])
def test_the_stop_at_a_probable_object_may_be_blocked(beyond_m, phase, tmp_path):
    loop = loop_of(tmp_path, "F bed", NEVER_SURE, probable="accept")
    chooser, grid = loop.service.goals.chooser, loop.service.map.grid
    while chooser.search.probable is None:
        loop.step()
    search = chooser.search
    stop_m, to_bed_m = np.array(search.probable.stop_m), np.subtract(*search.probable[:0:-1])
    to_bed_m /= np.hypot(*to_bed_m)
    while grid.state_at(*stop_m) == 0:  # the robot's estimate was off, towards the bed
        stop_m += 0.05 * to_bed_m
    stop_m += beyond_m * to_bed_m
    search.probable = search.probable._replace(score=1.0, stop_m=tuple(stop_m.tolist()))
    assert loop.run(250).service.status.phase == phase


def test_a_person_confirms_a_probable_object(tmp_path):
    loop = loop_of(tmp_path, 'F (bed & F "wait 3 s")', NEVER_SURE, probable="ask", time_limit_s=600)
    with pytest.raises(UserError, match="nothing to confirm"):
        ask(loop, "confirm")
    while loop.service.status.phase != "waiting" and not loop.service.status.done:
        loop.step()
    reason = loop.service.status.reason
    assert re.fullmatch(
        r"probably, .*: bed; waiting for `edge mission confirm`, 1 min left", reason
    ), reason
    bed = next(item for item in loop.world.objects if item.label == "bed")
    assert bed.distance_m(loop.drive.motion.pose.x_m, loop.drive.motion.pose.y_m) < 1.0
    loop.service.on_pose_jump(loop.drive.motion.stamp_ns)
    loop.step()
    assert loop.service.status.phase == "searching"
    while loop.service.status.phase != "waiting" and not loop.service.status.done:
        loop.step()
    ask(loop, "confirm")
    loop.step()
    assert "reached: bed (confirmed by a person)" in loop.notes.events
    assert (loop.service.mission.target, loop.service.mission.question) == ("wait 3 s", "")


@pytest.mark.parametrize(
    ("field", "value"),
    [("rounds", 0), ("rounds", "3"), ("rounds", 1e9), ("for_s", -1), ("for_s", float("nan"))],
)
def test_an_invalid_end_of_a_patrol_is_refused(field, value):
    with pytest.raises(ValueError, match=f"{field}: expected"):
        mission_verbs(prepare)["new"].read({"formula": "F a & F b", field: value})


@pytest.mark.parametrize("pose", [[1, 2], "here", [1, 2, True], [1, 2, 1e9], [1, 2, float("nan")]])
def test_an_invalid_caller_pose_is_refused(pose):
    with pytest.raises(ValueError, match=r"from_pose: expected \[x_m, y_m, yaw_rad\]"):
        mission_verbs(prepare)["new"].read({"formula": "F caller", "from_pose": pose})


@pytest.mark.parametrize("formula", ['F bed & G !"wait 3 s"', "F bed & G !explored"])
def test_a_wait_or_exploration_cannot_be_forbidden(formula, tmp_path):
    with pytest.raises(UserError, match="cannot be forbidden; leave it out"):
        prepare(loop_of(tmp_path, "F start").config.mission, formula=formula)
