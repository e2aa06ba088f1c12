"""Scorers in the background: their answers are used, and the robot drives without them."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from chat_server import likeliest, send, serving
from patience import PATIENCE_S, eventually
from simulated import simulated

from edge.config import Config
from edge.geometry import SE2
from edge.lab.eval.closed_loop import START_NS, ClosedLoop
from edge.loop.scoring.scorer_questions import IN_VIEW_NS, objects_in_view
from edge.loop.scoring.scorers import Scorers, make_scorers
from edge.loop.status import status_message
from edge.mission.spec import prepare
from edge.perception.runtime.cards import ModelError
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.tracked_objects import TrackedObjects
from edge.types import Instance, Observation

DIRECTION = {letter: -1.0 - i for i, letter in enumerate("ABCDEFGHJ")}
SCENE = {"Yes": math.log(0.75), "No": math.log(0.25)}


def model():
    """Serve a model that answers the two questions in turn."""
    answers = itertools.cycle([DIRECTION, SCENE])
    return lambda handler: send(handler, likeliest(next(answers)))


def settings(url: str, lockstep: bool = False, target: str = "surfboard") -> Config:
    choice = {"kind": "text", "url": url, "model": "m", "time_limit_s": PATIENCE_S}
    return simulated(
        {
            "loop": {"lockstep": lockstep},
            "sim": {"lockstep": True},
            "mission": {"target": target},
            "perception": {"choice": choice},
        }
    )


def frontiers_in_view(loop: ClosedLoop) -> ClosedLoop:
    """Step until the service has called its choice scorer."""
    for _ in range(80):
        loop.step()
        if status_message(loop.service.result())["scorers"]["choice"]["asked"]:
            return loop
    raise AssertionError("no frontier came into view")


@pytest.mark.parametrize("isolation", ["thread", "process"])
def test_a_new_model_is_loaded_in_a_process_first(isolation):
    """A model that never ends could not be killed in a thread."""
    made: list[tuple[str, str, str]] = []

    class Fake:
        def __init__(self, name: str, where: str) -> None:
            self.name, self.where = name, where
            made.append(("open", name, where))

        def close(self) -> None:
            made.append(("close", self.name, self.where))

    perception = simulated({"perception": {"choice": {"kind": "onnx", "card": "old"}}})
    config = perception.model_copy(
        update={"perception": perception.perception.model_copy(update={"isolation": isolation})}
    )
    scorers = make_scorers(
        config, ["bed"], make_choice=lambda choice, p: Fake(choice.card, p.isolation)
    )
    scorers.swap.request("new")
    eventually(lambda: ("open", "new", isolation) in made)
    apart = [("open", "new", "process"), ("close", "new", "process")]
    tried = apart if isolation == "thread" else []
    assert made == [("open", "old", isolation), *tried, ("open", "new", isolation)]
    scorers.swap.close()


@pytest.mark.parametrize("lockstep", [False, True])
def test_the_answer_of_the_scorer_is_used(lockstep):
    with serving(model()) as server:
        loop = frontiers_in_view(ClosedLoop(settings(server.url, lockstep)))
        if lockstep:  # at once, or a run would not replay the same
            assert loop.scorers.answers.choice.stamp_ns == loop.service.stamp_ns
        choice = eventually(lambda: loop.step() or loop.scorers.answers.choice)
        status = status_message(loop.service.result())["scorers"]["choice"]
        loop.close()
    assert set(choice.ids) <= set(range(1, 1000))
    assert choice.p.sum() + choice.elsewhere == pytest.approx(1.0, abs=1e-5)
    assert (np.diff(choice.p) < 0).all()
    assert choice.target == "surfboard"
    assert choice.scene == pytest.approx(0.75)
    assert status["model"] == f"m at {server.url}"
    assert status["scene"] == pytest.approx(0.75)
    assert list(status["frontiers"]) == [str(i) for i in loop.scorers.answers.choice.ids]
    assert status["answered"] >= 1
    assert "surfboard" in server.requests[0][2]["messages"][1]["content"]


def test_the_robot_continues_when_the_server_never_answers():
    """It finds the television as it would without a scorer; closing waits for no one."""
    with serving(lambda handler: handler.stopping.wait()) as server:
        loop = ClosedLoop(settings(server.url, target="television")).run(240)
        assert loop.service.status.phase == "reached", loop.service.status
        assert loop.scorers.answers.choice is None
        status = status_message(loop.service.result())["scorers"]["choice"]
        assert status["asked"] > status["answered"] == 0
        assert status["frontiers"] == {}
        loop.close()  # or the time limit of the test is over before that of the server


def test_answers_from_before_a_pose_jump_do_not_count():
    with serving(model()) as server:
        loop = frontiers_in_view(ClosedLoop(settings(server.url)))
        eventually(lambda: loop.step() or loop.scorers.answers.choice)
        eventually(lambda: loop.scorers._choice.idle)
        loop.step()  # asks again
        eventually(lambda: loop.scorers._choice.idle)
        loop.service.on_pose_jump(loop.drive.motion.stamp_ns)
        assert loop.scorers.answers.choice is None
        loop.scorers.collect_answers(
            loop.service.map.grid.values
        )  # the question about the old frame
        assert loop.scorers.answers.choice is None
        eventually(lambda: loop.step() or loop.scorers.answers.choice)
        loop.service.begin(prepare(loop.config.mission, "go to the bed"), START_NS)
        assert loop.scorers.answers.choice is None
        loop.close()


def test_no_question_is_asked_while_paused_or_ended():
    with serving(model()) as server:
        loop = frontiers_in_view(ClosedLoop(settings(server.url, lockstep=True)))
        asked = len(server.requests)
        loop.service.mission.pause(True)
        loop.step()
        assert len(server.requests) == asked
        loop.service.mission.pause(False)
        loop.step()
        assert len(server.requests) > asked
        loop.close()


class FakeSimilarity:
    name = "fake"

    def score(self, rgb, prompts):
        return np.arange(len(prompts), dtype=np.float32) + rgb.mean()

    def close(self):
        pass


def test_similarity_is_for_every_target(monkeypatch):
    loop = ClosedLoop(simulated({"loop": {"lockstep": True}, "mission": {"target": "bed"}}))
    scorers = Scorers(FakeSimilarity(), None, inline=True)
    seen = loop.observe()
    known = loop.service.map.pool.candidates, loop.service.map.tracker, loop.service.map.grid.values
    scorers.ask(seen, ("bed", "chair"), "bed", *known)
    scorers.collect_answers(loop.service.map.grid.values)
    similarity = scorers.answers.similarity
    np.testing.assert_allclose(similarity.score, seen.rgb.mean() + np.array([0, 1]), rtol=1e-6)
    assert similarity.targets == ("bed", "chair")
    assert (similarity.stamp_ns, similarity.pose) == (seen.stamp_ns, seen.pose)
    status = scorers.status()["similarity"]
    assert set(status["scores"]) == {"bed", "chair"}
    assert status["model"] == "fake"
    scorers.ask(replace(seen, rgb=None), ("bed",), "bed", *known)
    scorers.shed = frozenset({"similarity"})
    scorers.ask(seen, ("bed",), "bed", *known)
    assert scorers.status()["similarity"]["asked"] == 1
    scorers.close()


def test_the_running_detectors_scores_are_taken_from_its_detections():
    name = "running-detector-similarity"
    lockstep = {"loop": {"lockstep": True}, "sim": {"lockstep": True}}
    config = simulated({**lockstep, "perception": {"similarity": name}})
    loop = ClosedLoop(config).run(3)
    similarity = loop.scorers.answers.similarity
    assert similarity.targets == ("chair",)
    assert similarity.score.shape == (1,)
    status = status_message(loop.service.result())["scorers"]
    assert status["similarity"]["model"].startswith(f"{name} (sim")
    assert "choice" not in status
    assert loop.scorers.names() == [name]


def test_objects_around_are_in_the_prompt():
    tracker, around = InstanceTracker(simulated().perception), TrackedObjects(8)
    seen_ns = 5 * IN_VIEW_NS
    center = np.array([4.0, 1.0, 0.5], np.float32)
    tracker.add(Instance(1, "TV", center, center[None], 0.5, 3, 0, seen_ns, "rejected"))
    objects = [("stove", 2.0, 3, 0), ("television", 1.0, 3, 0)]
    objects += [("lamp", 1.0, 1, 0), ("desk", 1.0, 3, IN_VIEW_NS + 1)]
    around.words, around.n = [word for word, *_ in objects], len(objects)
    for i, (_, x_m, hits, ago_ns) in enumerate(objects):
        around.word[i], around.hits[i], around.xyz_m[i] = i, hits, (x_m, 1.0, 0.5)
        around.last_seen_ns[i] = seen_ns - ago_ns
    viewed = objects_in_view(tracker, around, Observation(0, seen_ns, SE2(0.0, 1.0, 0.0).matrix()))
    # Objects that are rejected, seen once or seen long ago are not named.
    assert [(s.label, s.distance_m) for s in viewed] == [("stove", pytest.approx(2.0))]


@pytest.mark.parametrize(
    "perception", [{"similarity": "made-up"}, {"similarity": "yolo-world-s-256x320-int8-cpu"}]
)
def test_bad_cards_fail_at_the_start_in_one_line(perception):
    with pytest.raises(ModelError, match=r"^perception\.similarity: model '[^\n]*$"):
        make_scorers(simulated({"perception": perception}), ("chair",))
