"""A detector in a process of its own that crashes, hangs, gives false results, and comes back."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from fake_model_process import ENGINE, EXIT, FAILURE, HANG, NAN, NO_MEMORY, SEGFAULT, TOO_MANY
from live_patience import PATIENCE_S, eventually

from edge import config
from edge.perception.detection import process as process_detector
from edge.perception.embedding.text import PromptError
from edge.perception.factory import make_detector
from edge.perception.process import link, supervised, wire
from edge.perception.process.wire import ModelProcessError
from edge.perception.runtime.cards import ModelError, card_names
from edge.perception.runtime.health import ModelHealth, log_progress
from edge.perception.swap import detector as swaps

FAKE = Path(__file__).parent / "fake_model_process.py"
# Only a test of a hang may take a slow machine for one.
QUICK = {"timeout_s": PATIENCE_S, "start_timeout_s": PATIENCE_S}
SMALL = "mini-house-256x320-int8-cpu"


@pytest.fixture(autouse=True)
def _again_at_once(monkeypatch):
    monkeypatch.setattr(supervised, "BACKOFF_S", 0.01)
    monkeypatch.setattr(supervised, "MOST_ENDS", 1000)


@pytest.fixture
def once(monkeypatch):
    """One restart, and no more for a long time."""
    monkeypatch.setattr(supervised, "MOST_ENDS", 1)
    monkeypatch.setattr(supervised, "WINDOW_S", 1e6)


def steered(prompts=("chair",), script=None, progress=log_progress, **process):
    chosen = config.DetectorOnnx(model="steered", vocabulary=script and str(script))
    rules = config.ModelProcessConfig(**{**QUICK, **process})
    perception = config.PerceptionConfig(isolation="process", process=rules, detector=chosen)
    return make_detector(perception, prompts, progress)


def pid_of(detector):
    return detector._link._process.pid


def halt(pid):
    """Stop all threads of a process, and wait until they are."""
    os.kill(pid, signal.SIGSTOP)
    states = Path(f"/proc/{pid}/task").glob("*/stat")
    eventually(lambda: all(s.read_text().rpartition(") ")[2][0] == "T" for s in states))


@pytest.fixture(autouse=True)
def place(monkeypatch, tmp_path_factory):
    """Put the fake in place of the model process; check that it leaves no files."""
    folder = tmp_path_factory.mktemp("shm")
    monkeypatch.setattr(link, "PROGRAM", (sys.executable, str(FAKE)))
    monkeypatch.setattr(wire, "SHARED_MEMORY", folder)
    monkeypatch.setattr(process_detector, "_CHECK_S", PATIENCE_S)
    before = psutil.Process().children()  # other tests' trackers of shared memory
    yield folder
    eventually(lambda: set(psutil.Process().children()) <= set(before), "a process is left")
    assert list(folder.iterdir()) == []


@pytest.fixture
def make():
    """make(**kw): a steered detector, closed at the end."""
    made = []

    def make(**kwargs):
        made.append(steered(**kwargs))
        return made[-1]

    yield make
    for detector in made:
        detector.close()


@pytest.fixture
def seen(make_observation):
    """seen(order, hw): an observation whose first pixel is an order."""

    def make(order=0, hw=(8, 10), seq=1, value=51):
        rgb = np.full((*hw, 3), value, np.uint8)
        rgb[0, 0, 0] = order
        return make_observation(seq=seq, rgb=rgb, hw=hw)

    return make


def back(detector):
    return eventually(lambda: detector.health().state == "ok", "it never came back")


def test_a_detector_in_a_process_returns_boxes(make, seen, place, tmp_path):
    script, told = tmp_path / "script", []
    script.write_text("build")

    def progress(health):
        told.append(health)
        script.write_text("")

    detector = make(prompts=("chair", "sofa"), script=script, progress=progress)
    assert told == [ModelHealth("building engine", "1 of 2")]
    assert detector.health() == ModelHealth()
    observation = seen(hw=(8, 10))
    found = detector.detect(observation)
    assert found.observation is observation
    assert found.xyxy_px.tolist() == [[0, 0, 10, 8]] * 2
    assert found.score.tolist() == [np.float32(observation.rgb.mean() / 255)] * 2
    assert found.class_id.tolist() == [0, 1]
    assert found.competing_score.tolist() == [0, 0]
    assert found.prompts == detector.prompts == ("chair", "sofa")
    assert found.model == detector.name == "steered"
    assert found.latency_ns > 0
    assert detector.health() == ModelHealth()
    assert detector.invalid_boxes == 7
    larger = seen(hw=(480, 640), value=102)
    assert detector.detect(larger).score[0] == np.float32(larger.rgb.mean() / 255)

    with pytest.raises(ValueError, match="it has no camera image to detect objects in"):
        detector.detect(seen().__class__(seq=1, stamp_ns=0, T_map_base=np.eye(4)))
    detector.detect(seen(ENGINE))
    assert detector.health() == ModelHealth("building engine", "3 of 9")
    detector.detect(seen())
    assert detector.health() == ModelHealth()

    with pytest.raises(ModelProcessError, match="steered, in its process: RuntimeError: no luck"):
        detector.detect(seen(FAILURE))
    assert len(detector.detect(seen())) == 2

    detector.set_prompts(["sofa", "bed"])
    assert detector.detect(seen()).prompts == detector.prompts == ("sofa", "bed")
    for prompts in ([], "sofa"):
        with pytest.raises(PromptError, match=r"no prompt|must be a list of words"):
            detector.set_prompts(prompts)
    with pytest.raises(PromptError, match="'nonsense': not in the vocabulary"):
        detector.set_prompts(["nonsense"])
    assert detector.detect(seen()).prompts == detector.prompts == ("sofa", "bed")


@pytest.mark.slow
def test_a_process_that_ends_is_reported_once_and_started_again(make, seen, caplog):
    caplog.set_level(logging.INFO)
    detector = make()
    ends = {
        SEGFAULT: "its process: ended by SIGSEGV",
        EXIT: "its process: ended with exit code 3",
        NO_MEMORY: "its process: ran out of memory; it was killed",
        NAN: r"its process: sent a damaged answer \(boxes that are not finite\); it was killed",
        TOO_MANY: r"its process: ended with exit code 1|damaged answer",
    }
    descriptors = []
    for order, says in ends.items():
        pid = pid_of(detector)
        with pytest.raises(ModelProcessError, match=says):
            detector.detect(seen(order))
        back(detector)
        assert not psutil.pid_exists(pid)
        assert len(detector.detect(seen())) == 1
        descriptors.append(len(os.listdir("/proc/self/fd")))
    told = [
        r.getMessage()
        for r in caplog.records
        if r.name.startswith("edge.perception.detection.process")
    ]
    assert len([t for t in told if "restarts in" in t]) == len(ends)
    assert len([t for t in told if t.endswith("its process runs")]) == len(ends)
    assert detector.restarts == len(ends)
    assert not any("\n" in t for t in told)
    assert descriptors[-1] <= descriptors[0]


def test_a_hang_is_ended(make, seen):
    """Both the model and the entire process are ended."""
    detector = make(timeout_s=0.1)
    says = r"no answer within 0\.1 s .*timeout_s.*killed"
    pid = pid_of(detector)
    with pytest.raises(ModelProcessError, match=says):
        detector.detect(seen(HANG))
    eventually(lambda: pid_of(detector) != pid and detector.health().state == "ok")
    assert not psutil.pid_exists(pid)
    halt(pid_of(detector))
    with pytest.raises(ModelProcessError, match=says):
        detector.detect(seen())


def test_a_process_waiting_for_a_core_gets_more_time(make, seen, monkeypatch):
    """A stopped process with a fake clock: it continues at 1.5 s, and is given up at 2 s."""
    detector = make(timeout_s=1.0)
    pid = pid_of(detector)
    clock_s, looks = [0.0], []

    def queued(now_s, waited_s):
        """Set the time at the first look; let the process continue some looks later."""

        def look(pid):
            clock_s[0] = now_s
            looks.append(now_s)
            if looks.count(now_s) == 4:
                os.kill(pid, signal.SIGCONT)
            return waited_s * (looks.count(now_s) > 1)

        return look

    monkeypatch.setattr(link, "time", SimpleNamespace(monotonic=lambda: clock_s[0]))
    halt(pid)
    monkeypatch.setattr(link, "_core_wait_s", queued(1.5, 0.6))
    assert len(detector.detect(seen())) == 1
    assert len(looks) >= 4
    clock_s[0] = 0.0
    halt(pid)
    monkeypatch.setattr(link, "_core_wait_s", queued(2.0, 100.0))
    with pytest.raises(ModelProcessError, match=r"no answer within 1 s .*timeout_s.*killed"):
        detector.detect(seen())


def test_only_the_main_thread_waiting_for_a_core_counts(monkeypatch, tmp_path):
    for path, waited_ns in (("8", 5), ("8/task/8", 5), ("8/task/9", 70)):
        (tmp_path / "proc" / path).mkdir(parents=True)
        (tmp_path / "proc" / path / "schedstat").write_text(f"123 {waited_ns}000000000 4\n")
    assert link._core_wait_s(os.getpid()) >= 0
    monkeypatch.setattr(link, "Path", lambda path: tmp_path / path.lstrip("/"))
    assert link._core_wait_s(8) == pytest.approx(5.0)
    assert link._core_wait_s(7) == 0


def test_a_restarting_process_keeps_its_prompts(make, seen, tmp_path):
    script = tmp_path / "script"
    script.write_text("")
    detector = make(prompts=("chair", "slow"), script=script)
    detector.detect(seen())
    script.write_text("wait")
    os.kill(pid_of(detector), signal.SIGKILL)
    says = "ended by SIGKILL, out of memory?; restarts in 0.0 s"
    eventually(lambda: says in detector.health().detail)
    assert detector.health().state == "restarting"
    for _ in range(100):
        with pytest.raises(ModelProcessError, match="SIGKILL"):
            detector.detect(seen())
    detector.set_prompts(["sofa", "bed"])
    assert detector.invalid_boxes == 7
    script.write_text("")
    back(detector)
    assert detector.detect(seen()).prompts == ("sofa", "bed")
    detector.detect(seen())
    assert detector.invalid_boxes == 14  # of both processes


def test_prompts_refused_later_raise_in_detect(make, seen, monkeypatch):
    monkeypatch.setattr(process_detector, "_CHECK_S", 0.05)
    detector = make()
    halt(pid_of(detector))
    detector.set_prompts(["nonsense"])
    monkeypatch.setattr(process_detector, "_CHECK_S", PATIENCE_S)
    os.kill(pid_of(detector), signal.SIGCONT)
    with pytest.raises(PromptError, match="'nonsense'"):
        detector.detect(seen())
    detector.set_prompts(["sofa"])
    assert detector.detect(seen()).prompts == ("sofa",)

    with monkeypatch.context() as damaged:
        damaged.setattr(link, "_receive", lambda channel: b"\xff")
        pid = pid_of(detector)
        detector.set_prompts(["nonsense"])
        assert "sent a damaged message (not JSON); it was killed" in detector.health().detail
    eventually(lambda: pid_of(detector) != pid and detector.health().state != "restarting")
    assert detector.health() == ModelHealth()
    with pytest.raises(PromptError, match="'nonsense'"):
        detector.detect(seen())
    detector.set_prompts(["sofa"])
    assert detector.detect(seen()).prompts == ("sofa",)


def test_a_check_of_prompts_ends_with_its_process(make, monkeypatch):
    detector, received = make(), []
    with monkeypatch.context() as closed:
        closed.setattr(link, "_receive", lambda channel: received.append(channel) or b"")
        assert not detector._link.check(["sofa"], 0.2)
    assert len(received) == 1


def test_ends_between_images_are_noticed_and_too_many_are_degraded(make, seen, caplog, once):
    detector = make()
    pid = pid_of(detector)
    os.kill(pid, signal.SIGTERM)
    eventually(lambda: pid_of(detector) != pid)
    assert not psutil.pid_exists(pid)
    back(detector)
    assert len(detector.detect(seen())) == 1
    os.kill(pid_of(detector), signal.SIGKILL)
    eventually(lambda: detector.health().state == "degraded")
    for _ in range(10):
        with pytest.raises(ModelProcessError, match=r"ended too often, restarts in 1000000 s"):
            detector.detect(seen())
    assert len([r for r in caplog.records if r.levelno == logging.ERROR]) == 1


def test_a_model_that_cannot_reload_is_degraded(make, seen, tmp_path):
    """And one that can again is back; it may be closed while it is started again."""
    script = tmp_path / "script"
    script.write_text("")
    detector = make(script=script)
    script.write_text("tiny.onnx: truncated")
    os.kill(pid_of(detector), signal.SIGKILL)
    eventually(lambda: detector.health().state == "degraded")
    assert detector.health().detail.startswith("tiny.onnx: truncated; restarts in")
    script.write_text("")
    back(detector)
    assert len(detector.detect(seen())) == 1

    script.write_text("wait")
    os.kill(pid_of(detector), signal.SIGKILL)
    eventually(lambda: detector.health().state == "restarting" and psutil.Process().children())
    detector.close()
    detector.close()


@pytest.mark.parametrize(
    ("said", "kind", "says"),
    [
        ("tiny.onnx: truncated", ModelError, "^tiny.onnx: truncated$"),
        ("exit", ModelProcessError, "ended with exit code 4 before it was ready"),
        ("wait", ModelProcessError, r"not ready after 0\.1 s \(.*start_timeout_s\)"),
        ("", PromptError, "'nonsense': not in the vocabulary"),
    ],
)
def test_a_failed_start_is_an_error(tmp_path, said, kind, says):
    (tmp_path / "script").write_text(said)
    limit_s = 0.1 if said == "wait" else PATIENCE_S
    with pytest.raises(kind, match=says) as error:
        steered(["nonsense"], tmp_path / "script", start_timeout_s=limit_s)
    assert type(error.value) is kind


def test_a_missing_program_is_an_error_at_the_start(monkeypatch):
    monkeypatch.setattr(link, "PROGRAM", ("/nowhere/python",))
    with pytest.raises(ModelProcessError, match=r"cannot be started: .*No such file"):
        steered()


def test_a_swap_given_up_while_its_process_starts_ends_that(tmp_path, monkeypatch):
    monkeypatch.setattr("edge.perception.swap.base.CLOSE_S", PATIENCE_S)
    (tmp_path / "script").write_text("wait")
    old = SimpleNamespace(name="old", prompts=("chair",))
    perception = config.PerceptionConfig(
        isolation="process",
        process=config.ModelProcessConfig(start_timeout_s=1e6),
        detector=config.DetectorOnnx(model="old", vocabulary=str(tmp_path / "script")),
    )
    worker = SimpleNamespace(model=old, detector=old, uses=lambda detector: False)
    swapper = swaps.DetectorSwap(perception, worker, lambda *_: None)
    others = set(psutil.Process().children())
    swapper.request("steered", False, 0)
    eventually(lambda: set(psutil.Process().children()) - others)
    swapper.close()
    assert set(psutil.Process().children()) <= others


def test_a_stopped_process_is_killed(make, monkeypatch):
    monkeypatch.setattr(link, "_STOP_S", 0.05)
    detector = make()
    halt(pid_of(detector))
    detector.close()
    assert not psutil.pid_exists(pid_of(detector))


def outlive(monkeypatch):
    """Stand-in for a process that the kernel cannot end: no SIGKILL reaches it."""
    monkeypatch.setattr(link.subprocess.Popen, "kill", lambda process: None)
    for module, limit in ((link, "_STOP_S"), (link, "_KILL_S"), (supervised, "_CLOSE_S")):
        monkeypatch.setattr(module, limit, 0.01)


def test_a_process_that_cannot_be_ended_is_left_behind(monkeypatch, caplog):
    detector = steered()
    pid, thread = pid_of(detector), detector._thread
    halt(pid)
    outlive(monkeypatch)
    detector.close()
    (told,) = (r.getMessage() for r in caplog.records if r.levelno == logging.ERROR)
    assert f"its process {pid} was killed, but does not end: left behind" in told
    os.kill(pid, signal.SIGKILL)
    thread.join(PATIENCE_S)


def test_an_unkillable_starting_process_is_left_behind(monkeypatch, caplog, tmp_path):
    (tmp_path / "script").write_text("wait")
    outlive(monkeypatch)
    with pytest.raises(ModelProcessError, match="not ready after"):
        steered(script=tmp_path / "script", start_timeout_s=0.01)
    found = re.search(r"its process (\d+) was killed, but does not end: left behind", caplog.text)
    pid = int(found[1])
    with contextlib.suppress(ProcessLookupError, ChildProcessError):  # it ends with its thread
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


@pytest.mark.parametrize(
    ("code", "says"),
    [
        (0, "ended with exit code 0"),
        (-signal.SIGSEGV, "ended by SIGSEGV"),
        (-signal.SIGKILL, "ended by SIGKILL, out of memory?"),
        (-35, "ended by signal 35"),
    ],
)
def test_the_end_of_a_process_is_described(code, says):
    assert link._end_reason(code) == says


PARENT = """
import os, sys
sys.path[:0] = {paths!r}
from test_perception_process import FAKE, link, pid_of, steered
link.PROGRAM = (sys.executable, str(FAKE))
detector = steered()
print(pid_of(detector), flush=True)
sys.stdin.read()
"""


@pytest.mark.slow
def test_a_process_does_not_outlive_its_parent():
    paths = [str(FAKE.parent), str(FAKE.parent.parent)]
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT.format(paths=paths)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    with parent:
        child = psutil.Process(int(parent.stdout.readline()))
        parent.kill()
        child.wait(PATIENCE_S)


def compare(inside, perception, observations):
    """Compare a detector here with one in its own process, bit for bit."""
    outside = make_detector(perception, inside.prompts)
    try:
        for observation in observations:
            a, b = inside.detect(observation), outside.detect(observation)
            arrays = [(a, b, ("xyxy_px", "score", "class_id", "competing_score"))]
            arrays.append((a.context, b.context, ("xyxy_px", "score", "class_id")))
            for ours, others, fields in arrays:
                for name in fields:
                    mine, its = getattr(ours, name), getattr(others, name)
                    assert (mine.dtype, mine.shape) == (its.dtype, its.shape)
                    assert mine.tobytes() == its.tobytes()
            assert (a.model, a.prompts) == (b.model, b.prompts)
            assert a.context.words == b.context.words
        return len(a)
    finally:
        outside.close()


def noise(make_observation, *sizes):
    random = np.random.default_rng(0)
    images = [random.integers(0, 256, (*hw, 3), np.uint8) for hw in sizes]
    return [make_observation(seq=i, rgb=rgb, hw=rgb.shape[:2]) for i, rgb in enumerate(images)]


def test_the_shipped_models_boxes_are_the_same_in_a_process(monkeypatch, make_observation):
    """With the program that is started outside of tests, too."""
    pytest.importorskip("onnxruntime")
    if SMALL not in card_names():
        pytest.skip(f"no card {SMALL}")
    monkeypatch.undo()
    chosen = config.DetectorOnnx(model=SMALL, tau_vl=1e-6, background=("sofa", "lamp"))
    inside = make_detector(config.PerceptionConfig(detector=chosen), ["chair", "bed"])
    rules = config.ModelProcessConfig(**QUICK)
    perception = config.PerceptionConfig(isolation="process", process=rules, detector=chosen)
    assert compare(inside, perception, noise(make_observation, (256, 320), (480, 640)))
