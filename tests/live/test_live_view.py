"""Updates of the live page: JSON for every status, images when they changed."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from results import observation, result
from rooms import KITCHEN
from simulated import simulated
from task_facts import INSTRUCTION, by_a_model, looking

from edge.bus.request_queue import RequestQueue
from edge.bus.verbs import Verb
from edge.geometry import SE2, Grid
from edge.host.service_manager import SystemdNotifier
from edge.live.page_json import MAX_LAYERS, MAX_POINTS
from edge.live.view import PUBLIC, LiveView
from edge.loop.monitoring.service_health import ServiceHealth
from edge.loop.result import Event, ScoredCandidates
from edge.memory import KnownObject, Place, Site, Zone
from edge.types import Goal, GoalStatus, Instance, MissionStatus

EVIL = "<script>\u202e\ud800'\"&\x1b[31m"
PARTS = {
    "loop": {"state": "ok", "failed": 0, "last_error": EVIL}, "checkpoint": None,
    "detector": {"model": EVIL, "state": "ok"}, "swap": {}, "scorers": {},
}  # fmt: skip


PIT_M = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))


@pytest.fixture
def view() -> LiveView:
    return LiveView(simulated({"mission": {"target": "chair"}}), ServiceHealth(SystemdNotifier({})))


def fetch(view: LiveView, path: str):
    page = view.pages()[path]()
    assert page.media_type == "application/json"
    return json.loads(page.body)


def full() -> dict:
    """Return a tick with every optional field set and text from outside."""
    found = Instance(
        1, EVIL, np.array([1, 2, 3], np.float32), np.ones((1, 3), np.float32), 0.5, 3, 0, 0
    )
    scored = ScoredCandidates(
        np.zeros(2, np.int8), np.arange(2), np.ones((2, 2), np.float32),
        np.array([0.5, math.nan], np.float32), np.array([1.0, math.inf], np.float32),
        np.zeros(2, np.bool_),
    )  # fmt: skip
    goal = Goal(1, SE2(1, 2, 0.5), "frontier", 0, (1.5, 2.0), math.inf, EVIL)
    return {
        "status": MissionStatus("chair", "searching", EVIL, instruction=EVIL),
        "observation": observation(1), "pose": SE2(1, 2, 3), "goal": goal,
        "goal_status": GoalStatus(1, "failed", EVIL), "events": (Event(1, EVIL),),
        "instances": lambda: [found], "candidates": lambda: scored,
        "objects": lambda: [KnownObject(1, EVIL, (1.0, 2.0, 0.5), 0.5, 3, 4.0)],
        "rooms": (KITCHEN,),
        "site": Site((Place("dock", SE2(1, 2, 0)), Zone("pit", "keep_out", PIT_M))),
        "path": lambda: np.ones((5000, 2), np.float32), "parts": lambda: PARTS,
        "layers": lambda: {"value of chair": lambda: Grid(np.full((2, 3), 9, np.uint8), (0, 0), 1)},
    }  # fmt: skip


def test_the_page_works_before_the_service_starts(view):
    view._health.starting("compiling")
    now = fetch(view, "/live/now")
    assert now["service"] == {"state": "starting", "ready": False, "why": ["starting: compiling"]}
    assert (now["status"], now["shots"], now["silent_s"]) == (None, {}, None)
    for path in ("mission", "task", "site", "memory", "map", "camera", "camera2", "layers/0"):
        assert fetch(view, f"/live/{path}") is None
    answer = view.forms()["/mission/request"](b'{"do": "pause"}')
    assert (int(answer.status), json.loads(answer.body)) == (
        503, {"error": "the service is starting"},
    )  # fmt: skip


def test_the_page_gets_the_labels_that_the_targets_mean(view):
    view.sink.mark_watched()
    view.sink.tick(result(**{**full(), "targets": {"every chair": "chair", "dock": "dock"}}))
    assert fetch(view, "/live/mission")["targets"] == ["chair", "dock"]


def test_only_the_page_itself_is_public(view):
    html = view.pages()["/"]().body.decode()
    for path in PUBLIC:
        assert path == "/" or path.startswith("/live/")
        assert view.pages()[path]().body
    assert {path for path in view.pages() if "." in path} == set(PUBLIC) - {"/"}
    assert "http" not in html.replace("http.token_file", "")


def test_all_pages_are_json_without_infinities(view):
    view.sink.mark_watched()
    view.sink.tick(result(**full()))
    status, log = fetch(view, "/live/now")["status"], fetch(view, "/live/mission")
    assert status["instances"][0]["label"] == EVIL
    assert status["goal"]["score"] is None
    assert [c["score"] for c in status["candidates"]] == [0.5, None]
    assert [c["path_m"] for c in status["candidates"]] == [1.0, None]
    assert len(status["path"]) <= MAX_POINTS
    assert log["events"] == [{"t_s": 1e-9, "text": EVIL}]
    assert log["layers"] == ["value of chair"]
    memory = fetch(view, "/live/memory")
    (known,) = memory["objects"]
    assert [(room["kinds"], room["area_m2"]) for room in memory["rooms"]] == [(["kitchen"], 12.0)]
    assert (known["name"], known["xyz"]) == (EVIL, [1.0, 2.0, 0.5])
    site = fetch(view, "/live/site")
    assert site["number"] == status["site"]
    assert [one["properties"]["name"] for one in site["features"]] == ["dock", "pit"]
    assert [node["current"] for node in log["automaton"]["nodes"]] == [True, False]


def test_layers_are_fetched_by_number_and_may_be_absent(view):
    view.sink.mark_watched()
    view.sink.tick(result(**full()))
    layer = fetch(view, "/live/layers/0")
    assert (layer["name"], layer["size"]) == ("value of chair", [3, 2])
    assert fetch(view, f"/live/layers/{MAX_LAYERS - 1}") is None


def test_an_empty_map_has_no_picture(view):
    view.sink.mark_watched()
    empty = Grid(np.zeros((0, 0), np.int8), (0.0, 0.0), 0.05)
    view.sink.tick(result(snapshot=lambda inflated: empty))
    assert fetch(view, "/live/map")["png"] == ""


@pytest.mark.parametrize(
    ("body", "status", "answer"),
    [
        (b"", 409, {"error": "not JSON"}),
        (b'{"do": "stop"}', 409, {"error": "do: unknown 'stop' (choices: pause)"}),
        (b'{"do": "pause"}', 200, {"did": "pause"}),
    ],
)
def test_a_request_is_answered_as_over_the_bus(view, body, status, answer):
    queue = RequestQueue("x", {"pause": Verb()}, lambda request, now_ns: {"did": request.do})
    view.open({"mission/request": Served(queue)})
    page = view.forms()["/mission/request"](body)
    assert (int(page.status), json.loads(page.body)) == (status, answer)
    queue.close()
    page = view.forms()["/mission/request"](body)
    assert json.loads(page.body) == {"error": "the service is stopping"}


class Served:
    """Request queue that is served right after each query."""

    def __init__(self, queue: RequestQueue) -> None:
        self._queue = queue

    def accept(self, payload, reply) -> None:
        self._queue.accept(payload, reply)
        RequestQueue.serve(self._queue, 0)


def test_a_task_is_encoded_once_and_its_progress_every_time(view):
    task = by_a_model(index=40)
    view.sink.mark_watched()
    view.sink.tick(result(task=lambda: task))
    script = fetch(view, "/live/task")
    assert view.pages()["/live/task"]() is view.pages()["/live/task"]()
    now = fetch(view, "/live/now")["status"]["task"]
    assert (now["number"], now["phase"]) == (script["number"], "driving")
    assert 0 < now["driven_m"] < script["length_m"]
    assert script["trajectory"][now["index"]] == task.refined.poses[40, [0, 1, 3]].round(3).tolist()
    assert script["instruction"] == INSTRUCTION
    assert script["coarse"][-1] == script["trajectory"][-1][:2]
    assert [(r["answer"] != "", r["code"] != "", r["error"] != "") for r in script["rounds"]] == [
        (True, False, True), (False, True, False),
    ]  # fmt: skip
    assert script["rounds"][1]["code"].splitlines()[1:] == task.rounds[1].code.splitlines()[1:]
    assert len(json.dumps(fetch(view, "/live/now"))) < 3000


def test_an_unwritten_task_has_no_lines(view):
    view.sink.mark_watched()
    view.sink.tick(result(task=looking))
    script = fetch(view, "/live/task")
    assert (script["missing"], script["coarse"], script["trajectory"]) == (["van", "gate"], [], [])
    assert [step["state"] for step in script["steps"]] == ["looked for", "looked for"]
    assert fetch(view, "/live/now")["status"]["task"]["index"] == -1
