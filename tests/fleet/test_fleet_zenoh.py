"""Robots with made-up bodies on a real router: missions shared, robots lost, false answers."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import pytest
import zenoh
from edge_processes import Edge
from fake_robots import LIMITS, FakeRobot, settings_of
from live_patience import PATIENCE_S, eventually
from ros_router import router

from edge.bus import presence
from edge.bus.session import BusError, open_session, zenoh_session
from edge.cli.fleet import table
from edge.cli.main import main
from edge.fleet import dispatch, roster
from edge.fleet.dispatch import Dispatcher, plan
from edge.fleet.roster import Robot, open_roster
from edge.mission.spec import prepare

THREE = "go to the bed, the sofa and the tv in any order; never go to the toilet"


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(dispatch, "POLL_S", 0.05)
    # A slow robot is not gone.
    for module in (roster, presence):
        monkeypatch.setattr(module, "ANSWER_S", 20.0)
    # Commands run in this process, whose signal handlers they must leave alone.
    monkeypatch.setattr("signal.signal", lambda *_: None)


@pytest.fixture
def port() -> Iterator[int]:
    with router() as port:
        yield port


@pytest.fixture
def robots(port) -> Iterator[Callable[..., FakeRobot]]:
    """Return a function that makes robots; each is discovered before it returns."""
    with ExitStack() as stack:
        other = stack.enter_context(zenoh_session(settings_of(port, "any"), "connect"))

        def make(name: str, announced: bool = True, **options: object) -> FakeRobot:
            robot = FakeRobot(port, name, announced=announced, **options)
            stack.callback(robot.close)
            if announced:
                eventually(lambda: f"robots/{name}" in presence.online_sessions(other, "robots/*"))
            return robot

        yield make


class Sharing:
    """A dispatcher on a thread of its own."""

    def __init__(
        self, port: int, words: str = THREE, patience_s: float = PATIENCE_S, **how: object
    ) -> None:
        self.told: list[str] = []
        self.outcomes: dict | None = None
        self.mission = None
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(port, words, patience_s, how), daemon=True
        )
        self._thread.start()

    def _run(self, port, words, patience_s, how):
        spec = prepare(LIMITS, instruction=words)
        with open_roster(settings_of(port, "any")) as seen:
            how = {"share": True, **how}
            self.mission = plan(spec, seen.ask_status(), **how)
            dispatcher = Dispatcher(seen, self.mission, self.told.append, patience_s)
            while not self._stop.is_set():
                orders = dispatcher.step()
                if orders is not None and dispatcher._is_over(orders):
                    self.outcomes = dict(orders.outcomes)
                    return
                seen.wait(0.05)

    def kill(self) -> None:
        self._stop.set()
        self._thread.join()

    def ended(self) -> dict[str, tuple[str, str]]:
        """Return (phase, robot) by target."""
        self._thread.join(PATIENCE_S)
        assert self.outcomes is not None, self.told
        words = {part.id: part.words[0] for part in self.mission.parts}
        return {words[id]: (o.phase, o.by) for id, o in self.outcomes.items()}


def targets(*robots: FakeRobot) -> set[str]:
    return {robot.mission.target for robot in robots if not robot.mission.done}


def test_commands_report_that_no_robot_was_found(port, capsys):
    assert main(["fleet", "list", f"tcp/127.0.0.1:{port}"]) == 0
    assert capsys.readouterr().out == "no robot found (Zenoh keys robots/*)\n"
    assert main(["mission", "pause", "--fleet", f"tcp/127.0.0.1:{port}"]) == 69


def test_robots_are_stopped_and_asked_by_command(port, robots, capsys):
    anna, bob = robots("anna"), robots("bob")
    where = f"tcp/127.0.0.1:{port}"

    def fleet(*words: str) -> tuple[int, str]:
        verb = ["fleet", "list"] if words[0] == "list" else ["mission", words[0], "--fleet"]
        code = main([*verb, where, *words[1:]])
        said = capsys.readouterr()
        return code, said.out + said.err

    with open_roster(settings_of(port, "any")) as seen:
        seen.send("anna", {"do": "new", "formula": "F bed"}, PATIENCE_S)
    code, said = fleet("pause")  # bob has nothing to pause; that is an error only if he is named
    assert (code, anna.mission.paused, bob.mission.paused) == (0, True, False)
    assert "anna:\n  instruction: F bed" in said
    assert "bob:\n  refused: no mission is running: no mission was given yet" in said
    assert fleet("pause", "bob")[0] == 69
    assert fleet("resume", "anna")[0] == 0
    assert not anna.mission.paused
    code, said = fleet("cancel", "carl", "anna")
    assert (code, anna.mission.done) == (69, False)
    assert "fleet: no robot 'carl' is online (choices: anna, bob)" in said
    assert fleet("cancel", "anna")[0] == 0
    assert anna.mission.reason == "cancelled"
    (shown,) = [line for line in fleet("list")[1].splitlines() if line.startswith("anna ")]
    assert shown.endswith("  ok      cancelled")
    told = {robot["robot"]: robot for robot in json.loads(fleet("list", "--json")[1])}
    assert told["anna"]["answer"]["phase"] == "failed"
    assert told["bob"]["answer"]["robot"]["pose"] == [0.0, 0.0, 0.0]
    code, said = fleet("new", "go to the bed", "--to", "carl")
    assert (code, "no robot 'carl'" in said) == (69, True)
    assert fleet("new", "frobnicate the bed")[0] == 65


def test_a_watcher_gets_only_changes(port, robots, tmp_path):
    anna = robots("anna")
    watching = Edge("fleet", "list", "--watch", f"tcp/127.0.0.1:{port}", cwd=tmp_path)
    try:
        watching.says("anna  idle  -  -  ok")
        anna.problems = ("no usable observations",)
        watching.says("anna  idle  -  -  no usable observations")
        anna.close()
        watching.says("anna  gone")
        assert watching.stop(signal.SIGTERM) == 0
        assert len([line for line in watching.lines if " anna " in line]) in (3, 4)
    finally:
        watching.kill()


def test_a_mission_in_three_parts_is_done_by_three(port, robots, capsys):
    three = [robots(name, reaches_in_s=0.1) for name in ("anna", "bob", "carl")]
    where, options = f"tcp/127.0.0.1:{port}", ("--share", "--json", "--patience", "60")
    assert main(["mission", "new", "--fleet", where, THREE, *options]) == 0
    parts = json.loads(capsys.readouterr().out)["parts"]
    assert {part["phase"] for part in parts} == {"reached"}
    assert {part["by"] for part in parts} == {"anna", "bob", "carl"}
    assert all(robot.mission.spec.automaton.propositions[-1] == "toilet" for robot in three)


def test_a_part_that_all_robots_fail_lists_their_reasons(port, robots):
    anna, bob = robots("anna"), robots("bob", blind_to=frozenset({"bed"}))
    sharing = Sharing(port, "go to the bed", patience_s=0.5, share=False)
    eventually(lambda: not anna.mission.done)
    anna.fail("no bed within 100 s")
    assert sharing.ended() == {"bed": ("failed", "anna, bob")}
    (outcome,) = sharing.outcomes.values()
    assert outcome.reason == "anna: no bed within 100 s; bob: it refused"
    assert any("the detector knows no bed" in line for line in sharing.told)
    assert bob.mission.ended == "idle"


def test_a_restarted_dispatcher_resumes_its_mission(port, robots):
    anna, bob = robots("anna", known={"bed": 1.0}), robots("bob", known={"sofa": 1.0})
    first = Sharing(port)
    eventually(lambda: targets(anna, bob) == {"bed", "sofa"})
    first.kill()
    anna.reach()
    second = Sharing(port)
    eventually(lambda: targets(anna, bob) == {"television", "sofa"})
    assert second.mission == first.mission
    bob.reach()
    anna.reach()
    assert second.ended() == {
        "bed": ("reached", "anna"), "sofa": ("reached", "bob"), "television": ("reached", "anna"),
    }  # fmt: skip
    assert (anna.service.begun, bob.service.begun) == (2, 1)
    third = Sharing(port)
    eventually(lambda: not anna.mission.done)
    assert third.mission.id != first.mission.id, "it was over: this is another one"
    third.kill()


def test_two_dispatchers_of_one_mission_do_nothing_twice(port, robots):
    anna, bob = robots("anna"), robots("bob")
    first = Sharing(port)
    eventually(lambda: anna.service.begun or bob.service.begun)
    second = Sharing(port)
    eventually(lambda: second.mission and not (anna.mission.done or bob.mission.done))
    # One after the other: were both free at once, each dispatcher might think of another.
    anna.reaches_in_s = 0.0
    eventually(lambda: anna.service.begun == 2 and anna.mission.done)
    bob.reach()
    assert first.ended() == second.ended()
    assert first.mission == second.mission
    assert (anna.service.begun, bob.service.begun) == (2, 1)


def test_two_dispatchers_with_different_missions_share_the_robots(port, robots):
    both = [robots(name, reaches_in_s=0.1) for name in ("anna", "bob")]
    one, other = Sharing(port), Sharing(port, "go to the chair, the lamp and the sink")
    assert [phase for phase, _ in one.ended().values()] == ["reached"] * 3
    assert [phase for phase, _ in other.ended().values()] == ["reached"] * 3
    past = [entry["phase"] for robot in both for entry in robot.service.control.past]
    assert past == ["reached"] * 4  # and two that are their last: none was replaced
    assert sum(robot.service.begun for robot in both) == 6


def test_a_robot_that_returns_learns_that_another_has_its_part(port, robots, monkeypatch):
    anna = robots("anna")
    sharing = Sharing(port, "go to the bed", patience_s=0.5)
    eventually(lambda: not anna.mission.done)
    bob = robots("bob")
    anna.presence._token.undeclare()  # cut off, and driving on
    eventually(lambda: not bob.mission.done)
    anna.presence.announce()
    eventually(lambda: bob.mission.done)
    assert bob.mission.reason == "another robot is working on it"
    anna.reach()
    assert sharing.ended() == {"bed": ("reached", "anna")}


@pytest.mark.parametrize("answer", [b"", b'{"phase": "searching"}', b"\xff" * 1000])
def test_a_robot_with_invalid_answers_is_shown_but_not_used(port, robots, answer):
    robots("bob", reaches_in_s=0.0)
    with Liar(port, "mallory\x1b[2J", answer), open_roster(settings_of(port, "any")) as seen:
        eventually(lambda: len(seen.names()) == 2)
        shown = table(seen.ask_status().values())
        assert "mallory [2J" in shown
        assert shown.replace("\n", "").isprintable()
        assert Sharing(port, "go to the bed").ended() == {"bed": ("reached", "bob")}


def test_a_silent_robot_does_not_delay_the_others(port, robots, monkeypatch):
    monkeypatch.setattr(roster, "ANSWER_S", 0.2)
    robots("bob", reaches_in_s=0.0)
    with Liar(port, "late", None), open_roster(settings_of(port, "any")) as seen:
        eventually(lambda: len(seen.names()) == 2)
        assert "no answer within 0.2 s" in table(seen.ask_status().values())
        assert Sharing(port, "go to the bed").ended() == {"bed": ("reached", "bob")}


class Liar:
    """A robot that is there and answers this to whatever it is asked, twice; None: nothing."""

    def __init__(self, port: int, name: str, answer: bytes | None) -> None:
        self._answer, self._held, self._over = answer, [], threading.Event()
        self._session = open_session(settings_of(port, "liar"), "listen")
        self._token = self._session.liveliness().declare_token(f"robots/{name}/alive/1")
        self._key = f"robots/{name}/mission/request"
        self._asked = self._session.declare_queryable(self._key, zenoh.handlers.RingChannel(64))
        self._thread = threading.Thread(target=self._lie, daemon=True)
        self._thread.start()

    def _lie(self) -> None:
        while not self._over.wait(0.01):
            while (query := self._asked.try_recv()) is not None:
                if self._answer is None:
                    self._held.append(query)
                    continue
                with query:
                    for _ in range(2):
                        query.reply(self._key, self._answer)

    def __enter__(self) -> None: ...

    def __exit__(self, *exception: object) -> None:
        self._over.set()
        self._thread.join()
        for query in self._held:
            query.drop()
        self._session.close()


def test_a_second_service_with_the_same_prefix_is_refused(port, robots, caplog):
    robots("anna")
    with pytest.raises(BusError, match=r"^zenoh.prefix: another service at tcp/.* robots/anna: "):
        robots("anna")
    told = "another service was started with the prefix robots/anna: that service ended"
    eventually(lambda: any(told in line for line in caplog.messages))
    robots("bob")


@pytest.mark.parametrize("order", ["together", "lower last"])
def test_one_of_two_services_started_at_once_stays(port, robots, monkeypatch, order):
    monkeypatch.setattr(presence, "_YIELD_S", PATIENCE_S if order == "together" else 0.2)
    if order == "together":  # on a busy machine a token takes longer to be seen
        monkeypatch.setattr(presence, "_SETTLE_S", 2.0)
    two = [robots("anna", announced=False) for _ in range(2)]
    two.sort(key=lambda robot: robot.presence._own, reverse=order == "lower last")

    def stays(robot: FakeRobot) -> bool:
        try:
            robot.presence.announce()
        except BusError:
            return False
        return True

    if order == "together":
        with ThreadPoolExecutor(2) as pool:
            assert sorted(pool.map(stays, two)) == [False, True]
    else:
        assert [stays(robot) for robot in two] == [True, False]
    with open_roster(settings_of(port, "any")) as seen:
        eventually(lambda: seen.ask_status().get("anna", Robot("anna")).status_reply)


def test_two_services_with_one_name_are_shown(port, robots):
    robots("anna")
    with open_session(settings_of(port, "anna"), "listen") as other:
        token = other.liveliness().declare_token("robots/anna/alive/other")
        with open_roster(settings_of(port, "any")) as seen:
            eventually(lambda: "2 services use this name" in seen.ask_status()["anna"].problem)
            token.undeclare()
            eventually(lambda: seen.ask_status()["anna"].status_reply)


def test_a_mission_survives_a_restarted_router(tmp_path, monkeypatch):
    from edge.host.ports import free_port

    port = free_port()
    with ExitStack() as stack:

        def start() -> Edge:
            process = Edge("fleet", "router", f"tcp/127.0.0.1:{port}", cwd=tmp_path)
            stack.callback(process.kill)
            return process.says("router: ready")

        before = start()
        anna = FakeRobot(port, "anna")
        stack.callback(anna.close)
        sharing = Sharing(port, "go to the bed", patience_s=60.0)
        eventually(lambda: not anna.mission.done)
        before.kill()
        eventually(lambda: any("the router is gone" in line for line in sharing.told))
        start()
        eventually(lambda: "the router is back" in sharing.told)
        anna.reach()
        assert sharing.ended() == {"bed": ("reached", "anna")}
        assert anna.service.begun == 1
