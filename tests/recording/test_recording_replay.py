"""A recorded run replays identically in every tick, with all inputs; and runs that differ."""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from patience import eventually
from recordings import Recording, small

from edge.config import Config
from edge.geometry import SE2
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.checkpoints.checkpoint import ServiceCheckpoint
from edge.loop.checkpoints.map_checkpoint import SUFFIX
from edge.loop.goals.goal import GoalTracker
from edge.loop.input_log import InputLog
from edge.loop.scoring.scorers import Scorers
from edge.loop.service import Service
from edge.memory import Place, Site, Zone
from edge.mission.spec import prepare
from edge.perception.scoring.choice.question import FrontierChoice
from edge.policies import make_policy
from edge.recording import commands, rolling
from edge.recording.channels import DEPTH, JOURNAL, json_channel
from edge.recording.file import McapReader, McapWriter, RecordingError
from edge.recording.journal import config_text
from edge.recording.replay import ReplayError, replay
from edge.recording.replay_source import ReplayTick
from edge.recording.rolling import files_of
from edge.recording.session import RecordedRun
from edge.sinks import mcap
from edge.sinks.mcap import McapSink
from edge.tasks.mission_spec import prepare_task
from edge.types import GoalStatus, Observation


def same(path: Path, ticks: int) -> None:
    session = RecordedRun(path)
    outcome = replay(session)
    assert (outcome.first, outcome.differing, outcome.ticks) == (None, 0, ticks)
    assert outcome.goals_then == outcome.goals_now
    assert (session.gap, session.truncation) == ("", "")


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    """Thirty ticks with a picture each, in a chunk of its own each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rolling, "SYNC_S", 1e-9)
        return Recording(tmp_path_factory.mktemp("drive"), rgb_hz=100.0).steps(30).close()


@pytest.mark.parametrize("mapped", ["depth", "cloud"])
def test_a_run_with_two_cameras(tmp_path, mapped):
    """Each observation comes back with its own image size and mount."""
    second = {"width_px": 64, "height_px": 48, "yaw_deg": 170.0}
    sensors = {"camera": {"width_px": 80, "height_px": 64}, "second_camera": second}
    if mapped == "cloud":
        sensors["lidar"] = {"z_m": 0.4, "pitch_deg": 15.0}
    config = small(sensors=sensors, mapping={"input": mapped})
    path = Recording(tmp_path, config, rgb_hz=100.0).steps(30).close()
    same(path, 30)
    seen = [step.observation for step in RecordedRun(path).steps() if step.observation]
    assert [o.camera_index for o in seen] == [0, 1] * 15
    for observation in seen:
        mounted = config.sensors.cameras[observation.camera_index]
        assert observation.depth_m.shape == (mounted.height_px, mounted.width_px)
        assert observation.rgb.shape[:2] == observation.depth_m.shape
        np.testing.assert_array_equal(observation.T_base_camera, mounted.T_base_camera())
    files = {m.topic for m in McapReader(path)}
    assert {"/camera2/rgb/compressed", "/camera2/depth", "/detections2"} <= files


def test_a_run_without_a_tick(tmp_path):
    recording = Recording(tmp_path)
    recording.service.idle(1, None)
    path = recording.close()
    same(path, 0)
    assert commands.replay(argparse.Namespace(file=path, config=None, detect=False)) == 1


def test_a_drive(drive, capsys):
    same(drive, 30)
    args = argparse.Namespace(file=drive, config=None, detect=False)
    assert commands.replay(args) == 0
    told = capsys.readouterr().out
    assert "30 ticks" in told
    assert "identical in every tick" in told


def test_a_task(tmp_path):
    """Background results come from the recording."""
    recording = Recording(tmp_path).steps(2)
    service, closed = recording.service, recording.closed
    task = prepare_task(closed.config, "go straight for 1 metre")
    service.begin(task, closed.drive.motion.stamp_ns)
    recording.steps(25)
    assert service.result().task().refined is not None
    same(recording.close(), 27)


def test_a_patrol_with_waits_and_checks(tmp_path):
    recording = Recording(tmp_path).steps(2)
    service, closed = recording.service, recording.closed
    place = Site((Place.at("near", closed.drive.motion.pose),))
    patrol = 'G F near & G F "wait 1 s" & G F "check sofa" & G F wait'
    spec = prepare(service.config.mission, formula=patrol, site=place)
    service.begin(spec, closed.drive.motion.stamp_ns)
    ticks = 7
    while service.mission.target != "wait":
        recording.steps(1)
        ticks += 1
    service.control.pause(False, closed.drive.motion.stamp_ns)
    recording.steps(3)
    assert service.mission.progress.round == 2
    service.control.cancel("cancelled", closed.drive.motion.stamp_ns)
    recording.steps(2)
    assert service.status.phase == "reached"
    same(recording.close(), ticks)


def test_all_kinds_of_inputs_replay(tmp_path):
    """Requests, answers, idle beats, a jump, a reload, a tick that fails, in one run."""
    recording = Recording(tmp_path).steps(5)
    service, closed = recording.service, recording.closed
    now_ns = closed.drive.motion.stamp_ns
    service.control.pause(True, now_ns)
    recording.steps(2)
    service.idle(now_ns + 1, SE2(0.0, 0.0, 0.0))
    service.control.pause(False, now_ns)
    service.control.stop("button", now_ns)
    recording.steps(2)
    service.control.stop("", now_ns)
    recording.steps(3)
    service.on_goal_status(GoalStatus(service.goals.goal.stamp_ns, "failed", "stuck", (1.0, 2.0)))
    recording.steps(3)
    service.begin(prepare(service.config.mission, formula="F sofa & F bed"), now_ns)
    recording.steps(5)
    pose = service.pose
    corners = tuple((pose.x_m + x, pose.y_m + y) for x, y in ((1, 1), (2, 1), (2, 2)))
    site = Site((Place.at("dock", pose), Zone("rug", "keep_out", corners)))
    service.change_site(site, now_ns)
    there = prepare(service.config.mission, "go to the dock and come back", site=site)
    service.begin(there, closed.drive.motion.stamp_ns)
    recording.steps(5)
    service.on_pose_jump(closed.drive.motion.stamp_ns)
    recording.steps(4)
    for k in range(12):  # nothing to be seen, until no one drives on
        service.idle(closed.drive.motion.stamp_ns + k * 200_000_000, SE2(0.1, 0.2, 0.3))
    other = small(policy={"kind": "nearest_frontier"}, perception={"tau_det": 0.5})
    service.reconfigure(other, make_policy(other.policy))
    recording.steps(5)
    broken = Observation(1000, now_ns, np.full((4, 4), np.nan), depth_m=np.ones((3, 5), np.float32),
                         camera=closed.rig.model)  # fmt: skip
    with pytest.raises((ValueError, IndexError)):
        service.tick(broken, now_ns)
    service.idle(now_ns, None, broken)
    service.control.fail("cancelled", now_ns)
    recording.steps(2)
    kinds = {entry.kind for m in RecordedRun(recording.close()).steps() for entry in m.page.entries}
    assert kinds >= {
        "start", "tick", "idle", "goal_status", "mission", "pause", "stop", "fail", "config",
        "jump", "site",
    }  # fmt: skip
    same(files_of(tmp_path)[0], 37)


@pytest.mark.parametrize("field", ["rgb", "depth_m"])
def test_observations_that_were_refused_are_refused_again(tmp_path, field, monkeypatch):
    """The recorded decisions are replayed, because not every image is recorded."""
    kept, add_frame = [], ReplayTick.add_frame
    monkeypatch.setattr(ReplayTick, "add_frame", lambda *a: kept.append(a[1].seq) or add_frame(*a))
    recording = Recording(tmp_path).steps(5)
    closed, see = recording.closed, recording.closed.observe
    closed.observe = lambda: replace(o := see(), **{field: np.zeros_like(getattr(o, field))})
    recording.steps(15)
    assert recording.service.goals.goal is None
    closed.observe = see
    same(recording.steps(5).close(), 25)
    # The frame before a long blindness waits for its detections, so refused ones may not oust it.
    assert len(kept) == 10


URL = "http://127.0.0.1:9/v1"


def test_replay_repeats_the_counts_of_detector_images(drive, tmp_path, monkeypatch):
    """The number of detector images decides when a search is abandoned."""
    judge, images = GoalTracker.check_progress, []

    def spy(self, grid, pose, mission, done, *rest):
        images.append(done)
        return judge(self, grid, pose, mission, done, *rest)

    monkeypatch.setattr(GoalTracker, "check_progress", spy)
    path = Recording(tmp_path, small(loop={"lockstep": True})).steps(10).close()
    then, images[:] = tuple(images), []
    same(path, 10)
    assert tuple(images) == then
    assert then[-1] >= 3


class Thinks:
    """A choice scorer that answers on command."""

    name = "thinks"

    def __init__(self) -> None:
        self.told = threading.Semaphore(0)
        self.thinks = False

    def prepare(self, view):
        return view

    def answer(self, view):
        self.thinks = True
        self.told.acquire()
        self.thinks = False
        n = len(view.marks)
        p = np.linspace(1.0, 2.0, n, dtype=np.float32) / np.float32(2.0 * n)
        ids = tuple(mark.id for mark in view.marks)
        return FrontierChoice(
            view.observation.stamp_ns, view.target, ids, p, 1.0 - float(p.sum()), 0.7
        )

    def close(self):
        self.told.release()


def test_replay_delivers_background_results_at_their_ticks(tmp_path, monkeypatch):
    """On threads: a scorer, the survey for the planner, the cut into rooms."""
    config = small(
        loop={"lockstep": False},
        policy={"kind": "directional"},
        perception={"prior": "rooms", "choice": {"kind": "openai", "url": URL, "model": "m"}},
        mission={"instruction": "F bed & F sofa", "translator": {"kind": "ltl"},
                 "planner": {"kind": "vitl", "weights": "distance"}},
    )  # fmt: skip
    thinks = Thinks()
    monkeypatch.setattr(
        "edge.lab.eval.closed_loop.make_scorers",
        lambda config, targets: Scorers(None, thinks, value_source=config.value_source),
    )
    note, came = InputLog.note, Counter()

    def noted(journal: InputLog, kind: str, **fields: object) -> None:
        note(journal, kind, **fields)
        if kind == "result":
            came[fields["worker"]] += 1

    monkeypatch.setattr(InputLog, "note", noted)
    monkeypatch.setattr(mcap, "PENDING_BYTES", 500_000_000)
    recording, ticks = Recording(tmp_path, config), 0

    def all_came() -> bool:
        nonlocal ticks
        recording.steps(1)
        ticks += 1
        if ticks % 7 == 4 and thinks.thinks:
            thinks.told.release()
            eventually(lambda: not thinks.thinks)
        workers = came.keys() >= {"detector", "travel_cost", "rooms", "choice"}
        return workers and came["choice"] >= 2

    for _ in range(40):
        all_came()
    eventually(all_came, lambda: f"{ticks} ticks, of the workers came {dict(came)}")
    workers = Counter(
        entry.fields["worker"]
        for moment in RecordedRun(recording.close()).steps()
        for entry in moment.page.entries
        if entry.kind == "result"
    )
    assert workers == came
    same(files_of(tmp_path)[0], ticks)


def test_a_run_resumed_from_a_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "checkpoint.json"
    config = small(mission={"target": "bed", "checkpoint": str(path)})
    first = ClosedLoop(config)
    first.service.checkpoint = ServiceCheckpoint(config, path, None)
    for _ in range(25):
        first.step()
    first.service.checkpoint.close()
    before = first.service.status
    first.close()

    checkpoint = ServiceCheckpoint(config, path, None)
    assert checkpoint.saved is not None
    assert checkpoint.saved.path_m > 0.0
    sink = McapSink(config, str(tmp_path / "run"))
    second = ClosedLoop(config)
    second.service = Service(
        config, checkpoint.saved_spec(), second.worker, make_policy(config.policy),
        [second.notes, sink], checkpoint,
    )  # fmt: skip
    for _ in range(10):
        second.step()
    assert second.service.status.path_m > before.path_m
    second.close()
    sink.close()
    checkpoint.close()
    recorded = files_of(tmp_path / "run")[0]
    same(recorded, 10)
    monkeypatch.setattr("edge.host.checkpoint.VERSION", 7)
    with pytest.raises(
        ReplayError, match=r"in the recording .* version 6 of the format; this edge"
    ):
        replay(RecordedRun(recorded))


@pytest.mark.parametrize(
    ("localised", "boot", "elsewhere"),
    [
        (False, "this", [""]),
        (False, "another", ["the computer was rebooted, so its odometry restarted"]),
        (True, "another", ["", ""]),  # once more after the jump
    ],
)
def test_a_run_that_restores_its_map(tmp_path, monkeypatch, localised, boot, elsewhere):
    """Killed, and started again: in a replay there is neither its computer nor its clock."""
    monkeypatch.setattr("edge.loop.checkpoints.map_checkpoint.boot_id", lambda: "this")
    monkeypatch.setattr("edge.loop.checkpoints.map_checkpoint.PERIOD_S", 0.0)
    path, left = tmp_path / "mission.json", tmp_path / "left.json"
    config = small(source={"localised": localised})
    loop = ClosedLoop(config)
    killed = loop.service.checkpoint = ServiceCheckpoint(config, path, None)
    for _ in range(20):
        loop.step()
    known_m2, written = loop.service.map.grid.known_m2, killed.map.writer.written

    def is_saved() -> bool:
        loop.step()
        return killed.map.writer.written >= written + 2  # one copy may have begun before

    eventually(is_saved)
    eventually(lambda: killed.map.writer.idle and path.exists())
    for suffix in ("", SUFFIX):
        shutil.copy(f"{path}{suffix}", f"{left}{suffix}")
    killed.close()

    monkeypatch.setattr("edge.loop.checkpoints.map_checkpoint.boot_id", lambda: boot)
    checkpoint, sink = (
        ServiceCheckpoint(config, left, None),
        McapSink(config, str(tmp_path / "run")),
    )
    policy, sinks = make_policy(config.policy), [loop.notes, sink]
    loop.service = Service(config, checkpoint.saved_spec(), loop.worker, policy, sinks, checkpoint)
    loop.step()
    assert (loop.service.map.grid.known_m2 > 0.8 * known_m2) == (not elsewhere[0])
    for _ in range(5):
        loop.step()
    if localised:
        loop.service.on_pose_jump(loop.drive.motion.stamp_ns)
    for _ in range(5):
        loop.step()
    for one in (loop, sink, checkpoint):
        one.close()
    monkeypatch.setattr("edge.loop.checkpoints.map_checkpoint.boot_id", lambda: "a desk")
    recorded = files_of(tmp_path / "run")[0]
    entries = [e for m in RecordedRun(recorded).steps() for e in m.page.entries]
    assert [e.fields["value"] for e in entries if e.kind == "decision"] == elsewhere
    same(recorded, 11)


def test_a_run_in_several_files(tmp_path, monkeypatch):
    monkeypatch.setattr(rolling, "MAX_S", 1e-9)
    recording = Recording(tmp_path).steps(4)
    recording.close()
    files = files_of(tmp_path)
    assert len(files) == 4
    Recording(tmp_path / "other").steps(1).close()
    assert RecordedRun(files[0]).files == files
    same(files[0], 4)
    with pytest.raises(RecordingError, match=r"file 3 of a run: replay the first file"):
        replay(RecordedRun(files[2]))
    files[2].unlink()
    assert RecordedRun(files[0]).files == files[:2]
    same(files[0], 2)


def test_a_run_that_was_cut_off(drive, tmp_path):
    path = tmp_path / "edge-a.mcap.partial"
    path.write_bytes(drive.read_bytes()[: drive.stat().st_size // 2])
    session = RecordedRun(path)
    outcome = replay(session)
    assert 0 < outcome.ticks < 30
    assert outcome.first is None
    assert outcome.ended == f"{path}: cut off"


def copied(path: Path, out: Path, change, head=None) -> Path:
    """Copy a recording with `change(topic, payload)` applied; None drops the message."""
    reading = McapReader(path)
    messages = list(reading)
    metadata = {"edge-recording": {**reading.metadata["edge-recording"], **(head or {})}}
    with McapWriter(out, "lz4", metadata) as file:
        for m in messages:
            payload = change(m.topic, m.payload)
            if payload is not None:
                channel = json_channel(m.topic, m.schema) if m.encoding == "json" else DEPTH
                file.add(channel, m.log_ns, m.stamp_ns, payload, sequence=m.sequence)
    return out


def only(*topics):
    return lambda topic, payload: payload if topic in topics else None


def page(change):
    def changed(topic, payload):
        if topic != JOURNAL.topic:
            return payload if topic == DEPTH.topic else None
        told = json.loads(payload)
        return None if change(told) is False else json.dumps(told).encode()

    return changed


@pytest.mark.parametrize("stamp_ns", [None, -1, 1 << 64, "1"])
def test_a_frame_without_its_time_is_damage(drive, tmp_path, stamp_ns):
    def change(told):
        if told["observation"] is not None:
            told["observation"]["stamp_ns"] = stamp_ns

    with pytest.raises(RecordingError, match="damaged journal: ValueError: stamp_ns: "):
        replay(RecordedRun(copied(drive, tmp_path / "edge-a.mcap", page(change))))


def test_another_goal_then_is_a_difference_at_its_tick(drive, tmp_path, capsys):
    seen = []

    def change(told):
        seen.append(told)
        if len(seen) == 8:
            told["decisions"]["goal"]["pose"][0] += 1e-12

    path = copied(drive, tmp_path / "edge-a.mcap", page(change))
    outcome = replay(RecordedRun(path))
    assert (outcome.differing, outcome.first.tick) == (1, 8)
    args = argparse.Namespace(file=path, config=None, detect=False)
    assert commands.replay(args) == 1
    assert "differs in 1 of 30 ticks, first in tick 8 (stamp" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "ticks", "why"),
    [
        (only(JOURNAL.topic), 0, "the next frame's depth was dropped while recording"),
        (page(lambda told: told["entries"][0]["n"] not in range(20, 30)), None,
         "the messages that follow were dropped while recording"),
    ],
)  # fmt: skip
def test_dropped_messages_end_the_comparison(drive, tmp_path, change, ticks, why):
    path = copied(drive, tmp_path / "edge-a.mcap", change)
    session = RecordedRun(path)
    outcome = replay(session)
    assert outcome.ended == session.gap == why
    assert outcome.ticks < 10
    assert ticks is None or outcome.ticks == ticks
    assert outcome.differing == 0
    assert commands.replay(argparse.Namespace(file=path, config=None, detect=False)) == 1


@pytest.mark.parametrize(
    ("metadata", "payload", "why"),
    [
        ({}, b"{}", "an MCAP file, but not of the sink `mcap`"),
        ({"edge-recording": {"version": "9", "edge": "9.0"}}, b"{}",
         "recorded by edge 9.0 in version 9 of the format; this edge reads version 3"),
        ({"edge-recording": {"version": "3", "edge": "1"}}, b"{}", "damaged"),
        ({"edge-recording": {"version": "3", "edge": "1", "session": "a", "part": "0",
                             "config": '{"nonsense": 1}'}}, b"{}",
         "of edge 1, cannot be used"),
        ("good", b'{"entries": [{"n": 0, "kind": "spell"}]}', "damaged journal: KeyError"),
        ("good", b"[]", "damaged journal: TypeError"),
        ("good", b'{"entries": [{"n": 0, "kind": "jump", "now_ns": 1}], "observation": null, '
                 b'"decisions": null}', "does not begin with the service"),
    ],
)  # fmt: skip
def test_an_unusable_recording_is_refused_in_one_line(drive, tmp_path, metadata, payload, why):
    if metadata == "good":
        reading = McapReader(drive)
        next(iter(reading))
        metadata = reading.metadata
    path = tmp_path / "edge-a.mcap"
    with McapWriter(path, "lz4", metadata) as file:
        file.add(JOURNAL, 0, 0, payload)
    with pytest.raises(RecordingError, match=re.escape(why)) as caught:
        replay(RecordedRun(path))
    assert "\n" not in str(caught.value)


OWN = "strangers_own:Thing"
STRANGE = {
    "policy.kind": {"policy": {"kind": OWN}},
    "mission.planner.kind": {"mission": {"target": "bed", "planner": {"kind": OWN}}},
    "source.kind": {"source": {"kind": OWN}},
    "sinks.1.kind": {"sinks": ["zenoh", {"kind": OWN, "options": {"args": "true"}}]},
    "tasks.pipeline.kind": {"tasks": {"pipeline": {"kind": OWN}}},
}


def rewritten(path: Path, out: Path, config: Config, reloaded: Config | None = None) -> Path:
    """Copy a recording with another configuration in its header and its reloads."""

    def change(told):
        for entry in told["entries"]:
            if entry["kind"] == "config":
                entry["config"] = config_text(reloaded)

    return copied(path, out, page(change), {"config": json.dumps(config_text(config))})


@pytest.fixture
def strangers(tmp_path, monkeypatch):
    """Write a module that leaves a mark if it is imported or called."""
    mark = tmp_path / "imported"
    (tmp_path / "strangers_own.py").write_text(f"open({str(mark)!r}, 'w')")
    monkeypatch.syspath_prepend(tmp_path)
    yield mark
    sys.modules.pop("strangers_own", None)


@pytest.mark.parametrize("key", STRANGE)
def test_a_recording_runs_no_program_of_its_own(drive, tmp_path, strangers, key):
    """Otherwise the author of the recording could choose a program to run here."""
    path = rewritten(drive, tmp_path / "edge-a.mcap", small(**STRANGE[key]))
    args = argparse.Namespace(file=path, config=None, detect=False, trust=False)
    for way in (lambda: replay(RecordedRun(path)), lambda: commands.replay(args)):
        with pytest.raises(RecordingError) as caught:
            way()
        said = str(caught.value)
        assert said.startswith(f"{path}: {key}: {OWN} is no built-in kind")
        assert "--config" in said
        assert "--trust" in said
        assert "\n" not in said
    assert replay(RecordedRun(path), small()).first is None  # a given configuration replaces it
    assert not strangers.exists()


@pytest.fixture(scope="module")
def reloaded(tmp_path_factory) -> Path:
    recording = Recording(tmp_path_factory.mktemp("reloaded")).steps(2)
    other = small(policy={"kind": "nearest_frontier"})
    recording.service.reconfigure(other, make_policy(other.policy))
    return recording.steps(2).close()


@pytest.mark.parametrize("key", STRANGE)
def test_a_recorded_reload_runs_no_plugin(reloaded, tmp_path, strangers, key):
    path = rewritten(reloaded, tmp_path / "edge-a.mcap", small(), small(**STRANGE[key]))
    with pytest.raises(RecordingError, match=f"{re.escape(key)}: {OWN} is no built-in kind"):
        replay(RecordedRun(path))
    assert replay(RecordedRun(path), small()).ticks == 4
    assert not strangers.exists()


def test_a_recording_names_no_files(drive, tmp_path, monkeypatch):
    """A detector that it names opens the files of its card, and writes next to them."""
    folder = tmp_path / "engines"
    onnx = {"kind": "onnx", "model": "mini-house-256x320-int8-cpu", "engine_cache": str(folder),
            "vocabulary": str(tmp_path / "words.npz")}  # fmt: skip
    files = {"perception": {"detector": onnx}, "mission": {
        "target": "bed", "checkpoint": str(tmp_path / "checkpoint.json")}}  # fmt: skip
    path = rewritten(drive, tmp_path / "edge-a.mcap", small(**files))
    replay(RecordedRun(path))
    with pytest.raises(
        ReplayError, match=r"detector\.vocabulary: not read, because a recording may"
    ):
        replay(RecordedRun(path), detect=True)
    del onnx["vocabulary"]
    path = rewritten(drive, tmp_path / "edge-b.mcap", small(**files))
    made = []
    monkeypatch.setattr("edge.recording.replay.make_detector", lambda p, _: made.append(p) or 1 / 0)
    for trust in (False, True):
        with pytest.raises(RecordingError, match="ZeroDivisionError"):
            replay(RecordedRun(path, trust), detect=True)
    assert [p.detector.engine_cache for p in made] == [None, str(folder)]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["edge-a.mcap", "edge-b.mcap"]


def test_no_file(tmp_path):
    with pytest.raises(RecordingError, match="No such file"):
        RecordedRun(tmp_path / "a.mcap")


def test_detecting_again(drive, tmp_path):
    with pytest.raises(ReplayError, match="sim cannot detect in images"):
        replay(RecordedRun(drive), detect=True)
    onnx = {"kind": "onnx", "model": "mini-house-256x320-int8-cpu", "threads": 1}
    other = small(perception={"detector": onnx})
    outcome = replay(RecordedRun(drive), other, detect=True)
    assert (outcome.ticks, outcome.n_unrecorded) == (30, 0)
    without = Recording(tmp_path, rgb_hz=0.0).steps(3).close()
    assert replay(RecordedRun(without), other, detect=True).n_unrecorded == 3


def test_a_recording_holds_no_secret(tmp_path):
    config = small(zenoh={"endpoint": "tcp/127.0.0.1:7447#a=hush"},
                   perception={"choice": {"kind": "openai", "url": "http://me:hush@h/v1?k=hush",
                                          "model": "m"}})  # fmt: skip
    sink = McapSink(config, str(tmp_path), compression="none")
    closed = ClosedLoop(small(), sinks=[sink])
    closed.step()
    closed.close()
    sink.close()
    content = files_of(tmp_path)[0].read_bytes()
    assert b"7447" in content
    assert b"hush" not in content
