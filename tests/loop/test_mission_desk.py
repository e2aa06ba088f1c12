"""Orders to a running service: what is taken, what is refused, and that nobody waits for ever."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st
from patience import PATIENCE_S, eventually

from edge.bus.asking import OrderError
from edge.bus.desk import _WAITING, MAX_BYTES, MAX_CHARS, Desk, Request, _Asker
from edge.bus.session import open_session
from edge.config import Zenoh
from edge.errors import UserError
from edge.host.ports import free_port
from edge.loop.mission_desk import VERBS, MissionDesk, Order, parse_order
from edge.mission.order import ask

SETTINGS = Zenoh()
KEY = "edge/mission/request"


@pytest.mark.parametrize(
    ("data", "order"),
    [
        ({"do": "new", "instruction": "find the chair"}, Order("new", "find the chair")),
        ({"do": "new", "formula": "F chair"}, Order("new", formula="F chair")),
        ({"do": "new", "instruction": "é" * MAX_CHARS}, Order("new", "é" * MAX_CHARS)),
        *[({"do": verb}, Order(verb)) for verb in VERBS if verb != "new"],
    ],
)
def test_an_order(data, order):
    assert parse_order(json.dumps(data).encode()) == order
    assert parse_order(json.dumps(data, ensure_ascii=False).encode()) == order


@pytest.mark.parametrize(
    ("payload", "text"),
    [
        (b"", "not JSON"),
        (b"\xff\x00", "not JSON"),
        (b"[" * 60_000, "not JSON"),
        (b"9" * 60_000, "not JSON"),
        (b"[]", "not a JSON object"),
        (b"null", "not a JSON object"),
        (b"{}", "do: unknown None (choices: new, pause, resume, cancel, status)"),
        (b'{"do": "stop"}', "do: unknown 'stop' (choices: new, "),
        (b'{"do": ["new"]}', "do: unknown a list"),
        (b'{"do": {"a": [[]]}}', "do: unknown a dict"),
        (b'{"do": NaN}', "do: unknown nan"),
        (b'{"do": "pause", "why": 1}', "'why': not taken with do: pause"),
        (b'{"do": "pause", "formula": "F a"}', "'formula': not taken with do: pause"),
        (b'{"do": "new", "formula": "F a", "x": 1}', "'x': not taken with do: new"),
        (b'{"do": "new"}', "either an instruction or a formula"),
        (b'{"do": "new", "formula": "a", "instruction": "b"}', "either an instruction or a"),
        (b'{"do": "new", "formula": 3}', "formula: expected text, got 3"),
        (b'{"do": "new", "formula": null}', "formula: expected text, got None"),
        (b'{"do": "new", "formula": ["a"]}', "formula: expected text, got a list"),
        (b'{"do": "new", "instruction": " \\n"}', "instruction: expected text, got ' \\n'"),
        (b'{"do": "new", "instruction": "\\ud800"}', "instruction: not Unicode text"),
        (b'{"do": "new", "instruction": "' + b"a" * 10_001 + b'"}', "at most 10000"),
    ],
)
def test_no_order(payload, text):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        parse_order(payload)
    assert text in str(caught.value)
    assert len(str(caught.value)) < 200
    assert "\n" not in str(caught.value)


def parsed(payload: bytes) -> Order | str:
    try:
        return parse_order(payload)
    except ValueError as error:
        return str(error)


@given(st.binary(max_size=100))
def test_any_bytes_are_an_order_or_a_value_error(payload):
    assert parsed(payload)


@given(st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.sampled_from(VERBS),
    lambda x: st.lists(x) | st.dictionaries(st.sampled_from(["do", "instruction", "formula"]), x),
))  # fmt: skip
def test_any_json_is_an_order_or_a_value_error(data):
    order = parsed(json.dumps(data).encode())
    if isinstance(order, Order):
        given_texts = [t for t in (order.instruction, order.formula) if t is not None]
        assert len(given_texts) == (order.do == "new")
    else:
        assert "\n" not in order


@pytest.mark.parametrize("depth", [100, 900, 990, 1000, 5000, 30_000])
def test_a_deep_nest_is_a_value_error(depth):
    nest = b"[" * depth + b"]" * depth
    for payload in (b'{"do": %s}' % nest, b'{"do": "new", "formula": %s}' % nest):
        assert isinstance(parsed(payload), str)


# -- the desk itself, on a session of its own --------------------------------------------------


@pytest.fixture
def session() -> Iterator[zenoh.Session]:
    with open_session(Zenoh(endpoint=f"tcp/127.0.0.1:{free_port()}"), "listen") as session:
        yield session


@pytest.fixture
def open_desk(session) -> Iterator[Callable[..., MissionDesk]]:
    desks = []

    def open_desk(
        prepare: Callable = lambda *texts: texts, patience_s: float = PATIENCE_S
    ) -> MissionDesk:
        desks.append(MissionDesk(session, SETTINGS, prepare, patience_s))
        return desks[-1]

    yield open_desk
    for desk in desks:
        desk.close()


def taken(desk: MissionDesk) -> Request:
    """The next request, once it is there."""
    return eventually(desk.poll)


class Asking:
    """Asks on a thread of its own."""

    def __init__(self, session: zenoh.Session, **request: object) -> None:
        self._pool = ThreadPoolExecutor(1)
        self._answer = self._pool.submit(ask, session, SETTINGS, request, PATIENCE_S)
        self._pool.shutdown(wait=False)

    @property
    def done(self) -> bool:
        return self._answer.done()

    @property
    def answer(self) -> dict:
        return self._answer.result(PATIENCE_S)

    @property
    def outcome(self) -> dict | OrderError:
        try:
            return self.answer
        except OrderError as error:
            return error

    @property
    def refusal(self) -> str:
        with pytest.raises(OrderError) as caught:
            self._answer.result(PATIENCE_S)
        assert "\n" not in str(caught.value)
        return str(caught.value)


def test_an_idle_desk_has_nothing_for_the_loop(open_desk):
    assert open_desk().poll() is None


@pytest.mark.parametrize("do", ["pause", "resume", "cancel", "status"])
def test_an_order_is_answered_by_the_loop(session, open_desk, do):
    desk, asking = open_desk(), Asking(session, do=do)
    request = taken(desk)
    assert (request.do, request.prepared) == (do, None)
    request.answer({"phase": do, "é": [1, None]})
    assert asking.answer == {"phase": do, "é": [1, None]}
    assert desk.poll() is None


@pytest.mark.parametrize(
    ("given_text", "brief"),
    [({"instruction": "the chair"}, ("the chair", None)), ({"formula": "F a"}, (None, "F a"))],
)
def test_a_new_mission_comes_to_the_loop_prepared(session, open_desk, given_text, brief):
    desk, asking = open_desk(), Asking(session, do="new", **given_text)
    request = taken(desk)
    assert (request.do, request.prepared) == ("new", brief)
    request.answer({"formula": "F a"})
    assert asking.answer == {"formula": "F a"}


def test_the_loop_may_refuse_and_only_its_first_word_counts(session, open_desk):
    desk, asking = open_desk(), Asking(session, do="resume")
    request = taken(desk)
    request.refuse("not paused:\n  nothing to resume")
    request.answer({"phase": "late"})
    request.refuse("again")
    assert asking.refusal == "mission: refused: not paused: nothing to resume"
    asking = Asking(session, do="status")
    taken(desk).answer({})
    assert asking.answer == {}


def test_an_answer_is_what_it_was_when_it_was_given(session, open_desk):
    desk, asking, answer = open_desk(), Asking(session, do="status"), {"phase": "a"}
    taken(desk).answer(answer)
    answer["phase"] = "b"
    assert asking.answer == {"phase": "a"}


@pytest.mark.parametrize("answer", [{"a": object()}, {"cost": float("inf")}, {(1, 2): 3}])
def test_an_answer_that_is_not_json_is_an_error_to_the_asker_only(session, open_desk, answer):
    desk, asking = open_desk(), Asking(session, do="status")
    taken(desk).answer(answer)
    assert "internal error" in asking.refusal


def test_a_mission_that_cannot_be_prepared_never_comes_to_the_loop(session, open_desk, caplog):
    def prepare(instruction: str, formula: str) -> object:
        raise {"x": UserError("not understood: 'x'"), "y": ZeroDivisionError("bug")}[instruction]

    desk = open_desk(prepare)
    assert Asking(session, do="new", instruction="x").refusal.endswith("not understood: 'x'")
    assert not caplog.records
    with caplog.at_level(logging.CRITICAL):
        assert "internal error: Zero" in Asking(session, do="new", instruction="y").refusal
    assert desk.poll() is None


def test_while_one_mission_is_prepared_other_orders_pass_and_few_wait(session, open_desk):
    begun, go = threading.Semaphore(0), threading.Event()

    def prepare(instruction: str, formula: None) -> str:
        begun.release()
        assert go.wait(PATIENCE_S)
        return instruction

    desk = open_desk(prepare)
    first = Asking(session, do="new", instruction="first")
    assert begun.acquire(timeout=PATIENCE_S)
    others = [Asking(session, do="new", instruction=str(n)) for n in range(8)]
    for _ in range(3):
        asking = Asking(session, do="status")
        taken(desk).answer({"phase": "running"})
        assert asking.answer == {"phase": "running"}
    eventually(lambda: sum(asking.done for asking in others) == 6)
    go.set()
    briefs = []
    for _ in range(3):
        request = taken(desk)
        briefs.append(request.prepared)
        request.answer({"brief": request.prepared})
    assert first.answer == {"brief": "first"}
    assert briefs[0] == "first"
    outcomes = [asking.outcome for asking in others]
    assert sum("busy" in str(outcome) for outcome in outcomes) == 6
    assert {outcome["brief"] for outcome in outcomes if isinstance(outcome, dict)} == {*briefs[1:]}
    assert desk.poll() is None


class Preparing:
    """What `prepare` does: understands a mission as soon as `done` is told of it, at once where
    it is `quick`."""

    def __init__(self, quick: Iterable[str] = ()) -> None:
        self.begun: list[str] = []
        self._done = {text: threading.Event() for text in "abcdef"}
        for text in quick:
            self.done(text)

    def __call__(self, instruction: str, formula: None) -> str:
        self.begun.append(instruction)
        assert self._done[instruction].wait(PATIENCE_S)
        return instruction

    def done(self, text: str) -> None:
        self._done[text].set()


def give(desk: MissionDesk, session: zenoh.Session, texts: str) -> list[Asking]:
    """New missions that the desk takes in, one after the other."""
    asked, before = [], len(desk._open)
    for n, text in enumerate(texts, start=before + 1):
        asked.append(Asking(session, do="new", instruction=text))
        eventually(lambda n=n: len(desk._open) == n)
    return asked


def begin_all(desk: MissionDesk, number: int) -> list[str]:
    """Take and answer new missions, as the loop does; which they are."""
    begun = []
    for _ in range(number):
        request = taken(desk)
        begun.append(request.prepared)
        request.answer({"began": request.prepared})
    assert desk.poll() is None
    return begun


@pytest.mark.parametrize(
    ("given_texts", "begun"),
    [
        ("a", "a"),
        ("aaaa", "a"),
        ("abb", "ab"),
        ("aba", "aba"),  # b has not the last word
        ("aabbaaa", "aba"),
    ],
)
def test_equal_new_missions_one_after_the_other_are_one(session, open_desk, given_texts, begun):
    preparing = Preparing()
    desk = open_desk(preparing)
    asked = give(desk, session, given_texts)
    for text in begun:
        preparing.done(text)
    assert "".join(begin_all(desk, len(begun))) == begun
    assert [asking.answer["began"] for asking in asked] == list(given_texts)
    assert "".join(preparing.begun) == begun


def test_a_new_mission_joins_an_equal_one_that_waits_for_the_loop(session, open_desk):
    desk = open_desk(Preparing(quick="ab"), patience_s=1.0)
    asked = give(desk, session, "a")
    eventually(lambda: desk._second._groups[0].is_ready)
    asked += give(desk, session, "ab")
    assert begin_all(desk, 2) == ["a", "b"]
    assert [asking.answer["began"] for asking in asked] == ["a", "a", "b"]
    late = give(desk, session, "a")
    eventually(lambda: desk._second._groups[0].is_ready)
    late += give(desk, session, "a")
    assert all("the loop is not running" in asking.refusal for asking in late)
    assert desk.poll() is None


def test_a_flood_of_one_new_mission_leaves_room_for_others(session, open_desk, monkeypatch):
    monkeypatch.setattr("edge.bus.desk._SAME", 4)
    preparing = Preparing()
    desk = open_desk(preparing)
    give(desk, session, "a")
    eventually(lambda: preparing.begun)
    flood = give(desk, session, "aaa")
    for _ in range(3):
        assert "busy" in Asking(session, do="new", instruction="a").refusal
    (other,) = give(desk, session, "b")
    flood += give(desk, session, "aaaa")
    for text in "ac":  # as many as wait for one
        assert "busy" in Asking(session, do="new", instruction=text).refusal
    preparing.done("a")
    preparing.done("b")
    assert begin_all(desk, 3) == ["a", "b", "a"]
    assert other.answer == {"began": "b"}
    assert {asking.answer["began"] for asking in flood} == {"a"}


def test_a_loop_that_does_not_run_is_told_of(session, open_desk):
    desk = open_desk(patience_s=0.05)
    assert "the loop is not running" in Asking(session, do="pause").refusal
    assert "the loop is not running" in Asking(session, do="new", formula="F a").refusal
    assert desk.poll() is None


def test_a_loop_that_runs_and_does_not_come_to_an_order_is_not_called_stopped(session, open_desk):
    desk = open_desk(patience_s=0.2)
    asked = [Asking(session, do="new", formula=f"F {name}") for name in "ab"]
    # What goes first keeps the loop busy; it never comes to the prepared ones.
    while not all(asking.done for asking in asked):
        with desk._lock:
            desk._first.add(Order("status"), _Asker(None, lambda _: None))
        desk.poll()
    for asking in asked:
        assert "busy with other orders: not taken within 0.2 s" in asking.refusal


def test_a_loop_that_takes_an_order_and_says_nothing_is_told_of(session, open_desk, monkeypatch):
    desk = open_desk()
    asking = Asking(session, do="pause")
    request = taken(desk)
    late = SimpleNamespace(monotonic=lambda: time.monotonic() + PATIENCE_S)
    monkeypatch.setattr("edge.bus.desk.time", late)
    assert "taken, but not answered" in asking.refusal
    request.answer({"phase": "late"})
    asking = Asking(session, do="status")
    taken(desk).answer({"phase": "well"})
    assert asking.answer == {"phase": "well"}


def replies(session: zenoh.Session, payload: bytes | None, key: str = KEY) -> list[bytes]:
    """Error payloads that come back."""
    found = list(session.get(key, payload=payload, timeout=PATIENCE_S))
    assert all(reply.err is not None for reply in found)
    return [reply.err.payload.to_bytes() for reply in found]


@pytest.mark.parametrize(
    ("payload", "text"),
    [
        (None, "no payload"),
        (b"", "no payload"),
        (b"\x00\xff\xfe", "not JSON"),
        (b"[" * 60_000, "not JSON"),
        (b"{" + b" " * MAX_BYTES + b"}", "at most 65536"),
        (b"x" * 5_000_000, "at most 65536"),
        (b'{"do": "explode"}', "do: unknown 'explode'"),
    ],
)
def test_nonsense_is_answered_with_one_line(session, open_desk, payload, text):
    desk = open_desk()
    (answer,) = replies(session, payload)
    assert list(json.loads(answer)) == ["error"]
    assert text in json.loads(answer)["error"]
    assert len(answer) < 1100
    assert desk.poll() is None
    asking = Asking(session, do="status")
    taken(desk).answer({})
    assert asking.answer == {}


def test_a_very_long_error_is_cut_and_drives_no_terminal(session, open_desk):
    desk, asking = open_desk(), Asking(session, do="status")
    taken(desk).refuse("long\n\x1b[2J\u202e " * 10_000)
    assert asking.refusal.startswith("mission: refused: long [2J long")
    assert asking.refusal.isprintable()
    assert len(asking.refusal) < 1100
    assert desk.poll() is None


def test_who_asks_for_everything_below_the_prefix_gets_an_answer_too(session, open_desk):
    desk = open_desk()
    (answer,) = replies(session, None, "edge/**")
    assert "no payload" in json.loads(answer)["error"]
    asked = session.get("edge/**", payload=b'{"do": "status"}', timeout=PATIENCE_S)
    taken(desk).answer({"phase": "well"})
    assert [str(reply.ok.key_expr) for reply in asked] == [KEY]


def test_a_crowd_of_askers_gets_an_answer_each(session, open_desk):
    desk = open_desk()
    asking = [Asking(session, do="status") for _ in range(16)]
    answered = 0
    while not all(a.done for a in asking):
        if (request := desk.poll()) is not None:
            answered += 1
            request.answer({"n": answered})
    assert {a.answer["n"] for a in asking} == set(range(1, answered + 1))


def waiting(desk: MissionDesk, session: zenoh.Session, verbs: Iterable[str]) -> list[Asking]:
    """Orders that the desk takes in, one after the other, and the loop has not seen."""
    asked, before = [], len(desk._open)
    for n, verb in enumerate(verbs, start=before + 1):
        asked.append(Asking(session, do=verb))
        eventually(lambda n=n: len(desk._open) == n)
    return asked


@pytest.mark.parametrize(
    ("arrived", "done"),
    [
        ("", ""),
        ("pause pause pause", "pause"),
        ("pause cancel status pause cancel status", "pause cancel status"),
        ("pause resume pause", "pause resume pause"),
        ("resume resume pause resume", "resume pause resume"),
        ("status pause status", "status pause status"),
        ("resume cancel pause cancel status status", "resume cancel pause status"),
    ],
)
def test_equal_orders_are_one_for_the_loop_and_the_last_word_stands(
    session, open_desk, arrived, done
):
    desk = open_desk()
    asked = waiting(desk, session, arrived.split())
    for verb in done.split():
        request = desk.poll()
        assert request.do == verb
        request.answer({"did": verb})
    assert desk.poll() is None
    assert [a.answer["did"] for a in asked] == arrived.split()


@pytest.mark.parametrize("do", ["pause", "cancel"])
def test_what_stops_the_robot_stops_new_missions_that_were_given_before(session, open_desk, do):
    preparing = Preparing(quick="ade")
    desk = open_desk(preparing)
    before = give(desk, session, "aabcc")
    eventually(lambda: preparing.begun == ["a", "b"])  # a is ready, c waits
    before += give(desk, session, "d")
    (status,), stop = waiting(desk, session, ["status"]), Asking(session, do=do)
    assert all("stopped meanwhile: give it again" in asking.refusal for asking in before)
    after = give(desk, session, "e")
    requests = [desk.poll() for _ in range(2)]
    assert [(r.do, r.overtaken) for r in requests] == [("status", 0), (do, 4)]
    assert desk.poll() is None
    for request in requests:
        request.answer({"did": request.do})
    assert [status.answer, stop.answer] == [{"did": "status"}, {"did": do}]
    preparing.done("b")  # nobody waits for it
    assert begin_all(desk, 1) == ["e"]
    assert after[0].answer == {"began": "e"}
    assert preparing.begun == ["a", "b", "e"]


def test_what_stops_no_robot_leaves_what_is_to_be_prepared(session):
    desk = Desk(session, KEY, parse_order, {"new": lambda order: order.instruction})
    asked = give(desk, session, "a")
    eventually(lambda: desk._second._groups[0].is_ready)
    asked += waiting(desk, session, ["cancel"])
    assert [desk.poll().do for _ in range(2)] == ["cancel", "new"]
    desk.close()
    assert all("stopping" in asking.refusal for asking in asked)


class Flood:
    """A session, its queryable and all its queries, of which there is no end."""

    payload = None

    def declare_queryable(self, key: str, ring: object) -> Flood:
        return self

    def try_recv(self) -> Flood:
        return self

    def __enter__(self) -> Flood:
        return self

    def __exit__(self, *exception: object) -> None: ...

    def reply_err(self, payload: bytes, encoding: object) -> None: ...

    def undeclare(self) -> None: ...


def test_orders_that_come_faster_than_they_are_received_are_noticed(session, open_desk, caplog):
    desk = open_desk()
    asking = Asking(session, do="status")
    taken(desk).answer({})
    assert (asking.answer, desk.overruns) == ({}, 0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("edge.bus.desk._ARRIVED", 8)
        flooded = Desk(Flood(), "edge/flooded", parse_order, {})
        eventually(lambda: flooded.overruns >= 3)
        flooded.close()
    assert len([line for line in caplog.messages if line.startswith("edge/flooded: ")]) == 1


def test_what_stops_the_robot_always_finds_a_place(session, open_desk):
    desk = open_desk()
    flood = ["pause", "resume"] * 8
    asked = waiting(desk, session, flood[:_WAITING])
    for verb in ("status", "status"):
        assert "busy with other orders" in Asking(session, do=verb).refusal
    asked += waiting(desk, session, ["pause", "cancel", "pause", "cancel"])
    done = []
    while (request := desk.poll()) is not None:
        done.append(request.do)
        request.answer({"did": request.do})
    assert done == [*flood[:_WAITING], "pause", "cancel"]
    assert [a.answer["did"] for a in asked[_WAITING:]] == ["pause", "cancel"] * 2


def test_an_asker_that_has_gone_is_no_matter(session, open_desk):
    desk = open_desk()
    handler = session.get(KEY, payload=b'{"do": "status"}', timeout=0.01)
    request = taken(desk)
    assert [reply.err.payload.to_bytes() for reply in handler] == [b"Timeout"]
    request.answer({"phase": "late"})
    asking = Asking(session, do="status")
    taken(desk).answer({})
    assert asking.answer == {}


def test_closing_refuses_what_is_open_and_does_not_wait_for_a_translation(session, open_desk):
    begun, go = threading.Event(), threading.Event()

    def prepare(*texts: object) -> None:
        begun.set()
        go.wait(PATIENCE_S)

    desk = open_desk(prepare)
    open_orders = [Asking(session, do="new", formula="F a")]
    assert begun.wait(PATIENCE_S)
    open_orders += [Asking(session, do=do) for do in ("status", "resume")]
    requests = [taken(desk) for _ in range(2)]
    desk.close(0.2)
    assert all("the service is stopping" in asking.refusal for asking in open_orders)
    for request in requests:
        request.answer({"phase": "late"})
    go.set()
    assert "no service answers at edge/mission/request" in Asking(session, do="status").refusal
    desk.close()


def test_orders_that_arrive_as_the_desk_closes_are_told_so(session, open_desk, monkeypatch):
    monkeypatch.setattr("edge.bus.desk._RECEIVE_S", PATIENCE_S)  # it looks only when it closes
    desk = open_desk()
    payloads = (b'{"do": "status"}', b'{"do": "new", "formula": "F a"}', b"nonsense")
    asked = [session.get(KEY, payload=payload, timeout=PATIENCE_S) for payload in payloads]
    desk.close()
    answers = [json.loads(reply.err.payload.to_bytes()) for replies in asked for reply in replies]
    assert answers == [{"error": "the service is stopping"}] * 3
    assert desk.poll() is None


def test_a_desk_can_be_opened_where_one_was_closed(session, open_desk):
    for _ in range(3):
        desk = open_desk()
        asking = Asking(session, do="status")
        taken(desk).answer({})
        assert asking.answer == {}
        desk.close()


def test_a_session_that_is_closed_first_ends_the_desk_too(session, open_desk, caplog):
    desk = open_desk()
    session.close()
    eventually(lambda: caplog.messages)
    desk.close()
    assert [line.split(":")[0] for line in caplog.messages] == [
        "no more orders are taken, the session is closed"
    ]
    assert desk.poll() is None
