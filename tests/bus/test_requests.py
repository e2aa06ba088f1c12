"""Requests to a running service: each is answered once, and no client waits forever."""

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
from patience import PATIENCE_S, eventually

from edge.bus import request_queue, requests
from edge.bus.client import RequestError, send_request
from edge.bus.requests import MAX_BYTES, RequestServer
from edge.bus.session import open_session
from edge.bus.verbs import Request, Verb
from edge.config import ZenohConfig
from edge.errors import UserError
from edge.host.ports import free_port
from edge.loop.requests.handlers import mission_verbs

KEY = "edge/mission/request"


@pytest.fixture
def session() -> Iterator[zenoh.Session]:
    with open_session(ZenohConfig(endpoint=f"tcp/127.0.0.1:{free_port()}"), "listen") as session:
        yield session


@pytest.fixture
def serve(session) -> Iterator[Callable[..., RequestServer]]:
    servers = []

    def serve(
        prepare: Callable = lambda **texts: texts, patience_s: float = PATIENCE_S
    ) -> RequestServer:
        """Start a server of missions; the test takes its requests as the loop does."""
        verbs = mission_verbs(prepare)
        servers.append(RequestServer(session, KEY, verbs, broken, patience_s))
        return servers[-1]

    yield serve
    for server in servers:
        server.close()


def broken(request: Request, now_ns: int) -> dict:
    raise ZeroDivisionError("oh no")


def taken(server: RequestServer) -> Request:
    """Return the next request, once one has arrived."""
    return eventually(server.poll)


class Asking:
    def __init__(self, session: zenoh.Session, **request: object) -> None:
        self._pool = ThreadPoolExecutor(1)
        self._answer = self._pool.submit(send_request, session, KEY, request, PATIENCE_S, "mission")
        self._pool.shutdown(wait=False)

    @property
    def done(self) -> bool:
        return self._answer.done()

    @property
    def answer(self) -> dict:
        return self._answer.result(PATIENCE_S)

    @property
    def outcome(self) -> dict | RequestError:
        try:
            return self.answer
        except RequestError as error:
            return error

    @property
    def refusal(self) -> str:
        with pytest.raises(RequestError) as caught:
            self._answer.result(PATIENCE_S)
        assert "\n" not in str(caught.value)
        return str(caught.value)


def test_only_the_first_answer_or_refusal_counts(session, serve, monkeypatch):
    sent, send = [], RequestServer._send
    monkeypatch.setattr(RequestServer, "_send", lambda *reply: (sent.append(reply), send(*reply)))
    server, asking = serve(), Asking(session, do="resume")
    request = taken(server)
    request.refuse("not paused:\n  nothing to resume")
    request.answer({"phase": "late"})
    request.refuse("again")
    assert asking.refusal == "mission: refused: not paused: nothing to resume"
    asking = Asking(session, do="status")
    taken(server).answer({})
    assert asking.answer == {}
    assert len(sent) == 2


@pytest.mark.parametrize("n_dropped", [0, 2, 3])
def test_a_request_that_a_busy_service_dropped_is_sent_again(session, n_dropped):
    seen = []

    def answer(query: zenoh.Query) -> None:
        seen.append(query.selector)
        if len(seen) > n_dropped:
            query.reply(KEY, b"{}")

    queryable = session.declare_queryable(KEY, answer)
    asking = Asking(session, do="status")
    if n_dropped < 3:
        assert asking.answer == {}
        assert len(seen) == n_dropped + 1
    else:
        assert "no service answers" in asking.refusal
        assert len(seen) == n_dropped
    queryable.undeclare()


@pytest.mark.parametrize("answer", [{"a": object()}, {"cost": float("inf")}, {(1, 2): 3}])
def test_an_answer_that_is_not_json_is_an_internal_error(session, serve, answer):
    server, asking = serve(), Asking(session, do="status")
    taken(server).answer(answer)
    assert "internal error" in asking.refusal


def test_a_mission_that_cannot_be_prepared_is_refused(session, serve, caplog):
    def prepare(instruction: str) -> object:
        raise {"x": UserError("not understood: 'x'"), "y": ZeroDivisionError("bug")}[instruction]

    server = serve(prepare)
    assert Asking(session, do="new", instruction="x").refusal.endswith("not understood: 'x'")
    assert not caplog.records
    with caplog.at_level(logging.CRITICAL):
        assert "internal error: Zero" in Asking(session, do="new", instruction="y").refusal
    assert server.poll() is None


def test_other_requests_pass_while_a_mission_is_prepared(session, serve):
    begun, go = threading.Semaphore(0), threading.Event()

    def prepare(instruction: str) -> str:
        begun.release()
        assert go.wait(PATIENCE_S)
        return instruction

    server = serve(prepare)
    first = Asking(session, do="new", instruction="first")
    assert begun.acquire(timeout=PATIENCE_S)
    others = [Asking(session, do="new", instruction=str(n)) for n in range(8)]
    for _ in range(3):
        asking = Asking(session, do="status")
        taken(server).answer({"phase": "running"})
        assert asking.answer == {"phase": "running"}
    eventually(lambda: sum(asking.done for asking in others) == 6)
    go.set()
    briefs = []
    for _ in range(3):
        request = taken(server)
        briefs.append(request.prepared)
        request.answer({"brief": request.prepared})
    assert first.answer == {"brief": "first"}
    assert briefs[0] == "first"
    outcomes = [asking.outcome for asking in others]
    assert sum("busy" in str(outcome) for outcome in outcomes) == 6
    assert {outcome["brief"] for outcome in outcomes if isinstance(outcome, dict)} == {*briefs[1:]}
    assert server.poll() is None


class Preparing:
    """Stand-in for `prepare`: it returns when the test sets `done`, or at once if `quick`."""

    def __init__(self, quick: Iterable[str] = ()) -> None:
        self.begun: list[str] = []
        self._done = {text: threading.Event() for text in "abcdef"}
        for text in quick:
            self.done(text)

    def __call__(self, instruction: str) -> str:
        self.begun.append(instruction)
        assert self._done[instruction].wait(PATIENCE_S)
        return instruction

    def done(self, text: str) -> None:
        self._done[text].set()


def bring(server: RequestServer, session: zenoh.Session, requests: Iterable[dict]) -> list[Asking]:
    """Send requests that the server accepts but the loop has not taken."""

    def waiting() -> set[request_queue.Query]:
        queue = server.queue
        with queue._lock:
            return {query for lane in (queue._first, queue._second)
                    for request in lane for query in request.queries}  # fmt: skip

    asked = []
    for request in requests:
        before = waiting()
        asked.append(Asking(session, **request))
        eventually(lambda before=before: waiting() - before)
    return asked


def give(server: RequestServer, session: zenoh.Session, texts: str) -> list[Asking]:
    """Send new missions."""
    return bring(server, session, ({"do": "new", "instruction": text} for text in texts))


def begin_all(server: RequestServer, number: int) -> list[str]:
    """Take and answer new missions, as the loop does; which they are."""
    begun = []
    for _ in range(number):
        request = taken(server)
        begun.append(request.prepared)
        request.answer({"began": request.prepared})
    assert server.poll() is None
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
def test_equal_consecutive_missions_are_begun_once(session, serve, given_texts, begun):
    preparing = Preparing()
    server = serve(preparing)
    asked = give(server, session, given_texts)
    for text in begun:
        preparing.done(text)
    assert "".join(begin_all(server, len(begun))) == begun
    assert [asking.answer["began"] for asking in asked] == list(given_texts)
    assert "".join(preparing.begun) == begun


def test_a_flood_of_one_new_mission_leaves_room_for_others(session, serve, monkeypatch):
    monkeypatch.setattr("edge.bus.request_queue._MAX_MERGED", 4)
    preparing = Preparing()
    server = serve(preparing)
    give(server, session, "a")
    eventually(lambda: preparing.begun)
    flood = give(server, session, "aaa")
    for _ in range(3):
        assert "busy" in Asking(session, do="new", instruction="a").refusal
    (other,) = give(server, session, "b")
    flood += give(server, session, "aaaa")
    for text in "ac":  # as many as wait for one
        assert "busy" in Asking(session, do="new", instruction=text).refusal
    preparing.done("a")
    preparing.done("b")
    assert begin_all(server, 3) == ["a", "b", "a"]
    assert other.answer == {"began": "b"}
    assert {asking.answer["began"] for asking in flood} == {"a"}


def test_a_refusal_reports_a_loop_that_does_not_run(session, serve):
    server = serve(patience_s=0.05)
    assert "the loop is not running" in Asking(session, do="pause").refusal
    assert "the loop is not running" in Asking(session, do="new", formula="F a").refusal
    assert server.poll() is None


def test_a_request_without_an_answer_is_refused(session, serve, monkeypatch):
    server = serve()
    asking = Asking(session, do="pause")
    request = taken(server)
    late = SimpleNamespace(monotonic=lambda: time.monotonic() + PATIENCE_S)
    monkeypatch.setattr("edge.bus.request_queue.time", late)
    assert "request accepted, but not answered" in asking.refusal
    request.answer({"phase": "late"})
    asking = Asking(session, do="status")
    taken(server).answer({"phase": "well"})
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
def test_nonsense_is_answered_with_one_line(session, serve, payload, text):
    server = serve()
    (answer,) = replies(session, payload)
    assert list(json.loads(answer)) == ["error"]
    assert text in json.loads(answer)["error"]
    assert len(answer) < 1100
    assert server.poll() is None
    asking = Asking(session, do="status")
    taken(server).answer({})
    assert asking.answer == {}


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (ValueError("no such corner"), "no such corner"),
        (UserError("two corners"), "two corners"),
        (ZeroDivisionError("oh no"), "internal error: ZeroDivisionError: oh no"),
    ],
)
def test_a_check_of_fields_that_raises_refuses_only_its_request(session, error, text):
    def read(fields: dict) -> dict:
        raise error

    server = RequestServer(session, KEY, {"bad": Verb((), read), "status": Verb()}, broken)
    try:
        (answer,) = replies(session, b'{"do": "bad"}')
        assert json.loads(answer) == {"error": text}
        asking = Asking(session, do="status")
        taken(server).answer({})
        assert asking.answer == {}
    finally:
        server.close()


class BrokenQuery:
    """A query that cannot be answered."""

    def __enter__(self) -> None:
        raise RuntimeError("oh no")

    def __exit__(self, *exception: object) -> None: ...


@pytest.mark.parametrize("thread", ["receiver", "sender"])
def test_an_unexpected_error_ends_no_thread(session, serve, thread, monkeypatch, caplog):
    server = serve()
    if thread == "sender":
        for _ in server._threads:
            server._reply(BrokenQuery(), b"{}", False)
        eventually(lambda: caplog.text.count("could not be sent: oh no") == len(server._threads))
    else:

        def fail(query: object) -> bytes:
            raise RuntimeError("oh no")

        with monkeypatch.context() as patch:
            patch.setattr(requests, "_payload", fail)
            assert Asking(session, do="status").refusal.endswith("internal error: RuntimeError")
    asking = Asking(session, do="status")
    taken(server).answer({})
    assert asking.answer == {}


def test_a_very_long_error_is_cut_and_drives_no_terminal(session, serve):
    server, asking = serve(), Asking(session, do="status")
    taken(server).refuse("long\n\x1b[2J\u202e " * 10_000)
    assert asking.refusal.startswith("mission: refused: long [2J long")
    assert asking.refusal.isprintable()
    assert len(asking.refusal) < 1100
    assert server.poll() is None


def waiting(server: RequestServer, session: zenoh.Session, verbs: Iterable[str]) -> list[Asking]:
    return bring(server, session, ({"do": verb} for verb in verbs))


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
def test_equal_requests_reach_the_loop_once(session, serve, arrived, done):
    server = serve()
    asked = waiting(server, session, arrived.split())
    for verb in done.split():
        request = server.poll()
        assert request.do == verb
        request.answer({"did": verb})
    assert server.poll() is None
    assert [a.answer["did"] for a in asked] == arrived.split()


@pytest.mark.parametrize("do", ["pause", "cancel"])
def test_a_stop_request_cancels_new_missions_sent_before_it(session, serve, do):
    preparing = Preparing(quick="ade")
    server = serve(preparing)
    before = give(server, session, "aabcc")
    eventually(lambda: preparing.begun == ["a", "b"])  # a is ready, c waits
    before += give(server, session, "d")
    (status,), stop = waiting(server, session, ["status"]), Asking(session, do=do)
    assert all(
        "cancelled by a stop request that came later: send it again" in asking.refusal
        for asking in before
    )
    after = give(server, session, "e")
    requests = [server.poll() for _ in range(2)]
    assert [(r.do, r.cancelled) for r in requests] == [("status", 0), (do, 4)]
    assert server.poll() is None
    for request in requests:
        request.answer({"did": request.do})
    assert [status.answer, stop.answer] == [{"did": "status"}, {"did": do}]
    preparing.done("b")  # no client waits for it
    assert begin_all(server, 1) == ["e"]
    assert after[0].answer == {"began": "e"}
    assert preparing.begun == ["a", "b", "e"]


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


def test_a_flood_of_requests_is_counted_as_overruns(session, serve, caplog):
    server = serve()
    asking = Asking(session, do="status")
    taken(server).answer({})
    assert (asking.answer, server.overruns) == ({}, 0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("edge.bus.requests._RING_QUERIES", 8)
        flooded = RequestServer(Flood(), "edge/flooded", {}, broken)
        eventually(lambda: flooded.overruns >= 3)
        flooded.close()
    assert len([line for line in caplog.messages if line.startswith("edge/flooded: ")]) == 1


def test_a_full_queue_still_accepts_stop_requests(session, serve):
    server = serve()
    flood = ["pause", "resume"] * 8
    asked = waiting(server, session, flood[: request_queue._MAX_WAITING])
    for verb in ("status", "status"):
        assert "busy with other requests" in Asking(session, do=verb).refusal
    asked += waiting(server, session, ["pause", "cancel", "pause", "cancel"])
    done = []
    while (request := server.poll()) is not None:
        done.append(request.do)
        request.answer({"did": request.do})
    assert done == [*flood[: request_queue._MAX_WAITING], "pause", "cancel"]
    assert [a.answer["did"] for a in asked[request_queue._MAX_WAITING :]] == ["pause", "cancel"] * 2


def test_closing_refuses_open_requests_without_waiting_for_a_translation(session, serve):
    begun, go = threading.Event(), threading.Event()

    def prepare(**texts: str) -> None:
        begun.set()
        go.wait(PATIENCE_S)

    server = serve(prepare)
    asked = [Asking(session, do="new", formula="F a")]
    assert begun.wait(PATIENCE_S)
    asked += [Asking(session, do=do) for do in ("status", "resume")]
    requests = [taken(server) for _ in range(2)]
    server.close(0.2)
    assert all("the service is stopping" in asking.refusal for asking in asked)
    for request in requests:
        request.answer({"phase": "late"})
    go.set()
    assert "no service answers at edge/mission/request" in Asking(session, do="status").refusal
    server.close()


def test_a_session_that_is_closed_first_ends_the_server_too(session, serve, caplog):
    server = serve()
    session.close()
    eventually(lambda: caplog.messages)
    server.close()
    assert [line.split(":")[0] for line in caplog.messages] == [
        "requests are no longer accepted, the Zenoh session is closed"
    ]
    assert server.poll() is None


def test_serve_handles_refusals_errors_and_prepared_missions(session):
    def handle(request: Request, now_ns: int) -> dict:
        if request.do == "pause":
            raise UserError("not now")
        return broken(request, now_ns) if request.do == "cancel" else {"did": request.do}

    verbs = mission_verbs(lambda **texts: texts)
    server = RequestServer(session, KEY, verbs, handle)
    assert server.serve(0) == 0
    new = give(server, session, "ab")
    eventually(lambda: not server.queue._unprepared())
    others = waiting(server, session, ["status", "resume"])
    assert [server.serve(0) for _ in range(3)] == [3, 1, 0]
    assert [asking.answer["did"] for asking in (*others, *new)] == [
        "status",
        "resume",
        "new",
        "new",
    ]
    (refused,) = waiting(server, session, ["pause"])
    assert server.serve(0) == 1
    assert refused.refusal.endswith("refused: not now")
    (failed, after) = waiting(server, session, ["cancel", "status"])
    with pytest.raises(ZeroDivisionError):
        server.serve(0)
    assert failed.refusal.endswith("internal error: ZeroDivisionError: oh no")
    assert server.serve(0) == 1
    assert after.answer == {"did": "status"}
    server.close()
