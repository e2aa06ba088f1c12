"""A real HTTP server, in a thread, that plays a chat server of a test's choosing."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from http.server import BaseHTTPRequestHandler
from typing import Any

import http_server

Behaviour = Callable[[BaseHTTPRequestHandler], None]


@dataclass
class ChatServer:
    """`requests` holds what was asked: the path, the headers and the JSON body of each.

    Attributes:
        stopping: set at the end, so that a behaviour which would go on for ever ends too.
    """

    url: str = ""
    requests: list[tuple[str, dict[str, str], dict[str, Any]]] = field(default_factory=list)
    stopping: threading.Event = field(default_factory=threading.Event)


def send(handler: BaseHTTPRequestHandler, body: bytes, status: int = 200, **headers: str) -> None:
    """Send an entire answer; JSON unless a header says otherwise."""
    http_server.send(handler, body, status, **{"Content_Type": "application/json", **headers})


def stalls(handler: BaseHTTPRequestHandler) -> None:
    handler.stopping.wait()


def sends_100_mb(handler: BaseHTTPRequestHandler) -> None:
    """Blanks without end."""
    handler.send_response(200)
    handler.send_header("Content-Length", str(100 << 20))
    handler.end_headers()
    for _ in range(100):
        handler.wfile.write(b" " * (1 << 20))


def completion(content: Any, finish_reason: str = "stop") -> bytes:
    message = {"role": "assistant", "content": content}
    choice = {"index": 0, "message": message, "finish_reason": finish_reason}
    return json.dumps({"object": "chat.completion", "choices": [choice]}).encode()


def likeliest(logprobs: Any) -> bytes:
    """Return the body of a one-token chat completion, with log-probabilities of other tokens."""
    listed = isinstance(logprobs, dict)
    top = [{"token": t, "logprob": p} for t, p in logprobs.items()] if listed else logprobs
    choice = {
        "index": 0,
        "message": {"role": "assistant", "content": "A"},
        "finish_reason": "length",
        "logprobs": {"content": [{"token": "A", "logprob": -1.0, "top_logprobs": top}]},
    }
    return json.dumps({"object": "chat.completion", "choices": [choice]}).encode()


def saying(*answers: str) -> Behaviour:
    """Answers one after the other; the last one for ever."""
    left = list(answers)

    def behave(handler: BaseHTTPRequestHandler) -> None:
        send(handler, completion(left.pop(0) if len(left) > 1 else left[0]))

    return behave


def recorded(answers: Mapping[str, Sequence[str]]) -> Behaviour:
    """Answer from recorded answers, chosen by the instruction in the conversation.

    It skips as many as the model has already given; the last one repeats.
    """

    def behave(handler: BaseHTTPRequestHandler) -> None:
        messages = handler.asked["messages"]
        asked = json.dumps([m["content"] for m in messages if m["role"] == "user"])
        known = [given for instruction, given in answers.items() if instruction in asked]
        if not known:
            send(handler, b'{"error": "nothing was recorded for this"}', 404)
            return
        said = sum(message["role"] == "assistant" for message in messages)
        send(handler, completion(known[0][min(said, len(known[0]) - 1)]))

    return behave


@contextlib.contextmanager
def serving(
    behave: Behaviour, on_get: Behaviour | None = None, port: int = 0
) -> Iterator[ChatServer]:
    """Run a server on a local port, with its behaviour for questions and for other requests."""
    server = ChatServer()

    class Handler(http_server.Quiet):
        stopping = server.stopping

        def do_GET(self) -> None:
            (on_get or partial(send, body=b"{}"))(self)

        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            self.asked = json.loads(body)
            server.requests.append((self.path, dict(self.headers), self.asked))
            with contextlib.suppress(ConnectionError):
                behave(self)

    with http_server.running(Handler, server.stopping, port) as url:
        server.url = f"{url}/v1"
        yield server
