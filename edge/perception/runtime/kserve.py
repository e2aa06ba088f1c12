"""A model on a server, with the interface of the sessions of `edge.perception.runtime.sessions`.

One connection is kept open, and made again after every failure. Redirects and the environment's
proxies are ignored.
"""

from __future__ import annotations

import contextlib
import ssl
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Literal

import httpx
import numpy as np

from edge.host.http import (
    CancellableRequest,
    CuttableConnection,
    HttpReply,
    RequestCancelledError,
    explanation,
    failure_reason,
)
from edge.perception.runtime import kserve_messages as messages
from edge.perception.runtime.card_types import DetectCard, ImageCard
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.onnx_file import FLOAT, INT64, Value, expected_interface
from edge.text import one_line, redact

KSERVE = "kserve"
MOST_BYTES = 16 << 20
"""Largest answer. Boxes and scores of a large detector with 200 prompts are 7 MB."""
_DATATYPES = {FLOAT: "FP32", INT64: "INT64"}  # type number of ONNX → name in the protocol

Fault = Literal["no connection", "timeout", "invalid answer", "refused"]


class ServerError(ModelError):
    """A server that gave no usable answer: one line with the server, the fault and what to do.

    Attributes:
        kind: kind of the fault; `refused`: the server answered with an HTTP error.
    """

    def __init__(self, model: str, url: str, kind: Fault, what: str) -> None:
        super().__init__(f"model {model}: server {redact(url)}: {kind}: {what}")
        self.kind = kind


class KServeSession:
    """A session on a server, for one thread at a time; any thread may close it.

    The server is not asked before the first run.

    Attributes:
        binary: True if tensors are sent as bytes; known after the first connection.
    """

    def __init__(self, card: DetectCard | ImageCard) -> None:
        assert card.server is not None
        self.name, self._server = card.name, card.server
        self.binary = False
        inputs, outputs = expected_interface(card)
        self._inputs, self._outputs = _specs(inputs), _specs(outputs)
        self._link: _ServerLink | None = None
        self._current_request: CancellableRequest | None = None
        self._lock, self._closed = threading.Lock(), False

    def get_providers(self) -> list[str]:
        """Return the provider's name, as a session of onnxruntime does."""
        return [KSERVE]

    def run(self, names: Sequence[str] | None, feed: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        """Return the named outputs, as a session of onnxruntime does.

        A run takes at most `server.time_limit_s` of the card.

        Raises:
            ServerError: no usable answer.
        """
        names = list(self._outputs) if names is None else names
        return self.infer(feed, {name: self._outputs[name][1] for name in names})

    def bind(
        self,
        inputs: Mapping[str, np.ndarray],
        outputs: Mapping[str, tuple[int, ...]],
        live: Sequence[str],
    ) -> KServeBoundSession:
        """Bind as `binding.bind` does. `live` is ignored: each request contains all inputs."""
        return KServeBoundSession(self, inputs, outputs)

    def infer(
        self, feed: Mapping[str, np.ndarray], shapes: Mapping[str, messages.Shape]
    ) -> list[np.ndarray]:
        """Return outputs of these shapes; see `run`."""
        deadline_s = time.monotonic() + self._server.time_limit_s
        try:
            link = self._link or self._connect(deadline_s)
            headers, body = messages.infer_request(feed, list(shapes), self.binary)
            reply = self._ask(link, "POST", "/infer", deadline_s, headers, body)
            with self._check_answer():
                length = reply.headers.get(messages.HEADER_LENGTH)
                found = messages.infer_answer(reply.body, length, shapes)
        except ServerError as error:
            self._disconnect(is_waiting=error.kind == "timeout")
            raise
        return [found[name] for name in shapes]

    def close(self) -> None:
        """Abort the current request at once; do not call `run` afterwards."""
        with self._lock:
            self._closed, current_request = True, self._current_request
        if current_request is not None:
            current_request.cancel(RequestCancelledError())
        self._disconnect(is_waiting=current_request is not None)

    def _connect(self, deadline_s: float) -> _ServerLink:
        """Connect to the server and check that it has the model."""
        self._link = link = _ServerLink(self._server.url)
        server = self._ask(link, "GET", None, deadline_s)
        model = self._ask(link, "GET", "", deadline_s)
        with self._check_answer():
            self.binary = messages.speaks_binary(server.body)
            messages.check_metadata(model.body, self._inputs, self._outputs)
        return link

    def _ask(
        self,
        link: _ServerLink,
        method: str,
        path: str | None,
        deadline_s: float,
        headers: Mapping[str, str] = MappingProxyType({}),
        body: bytes | None = None,
    ) -> HttpReply:
        """Send a request; return the entire answer, of status 200.

        Args:
            link: the connection.
            method: HTTP method.
            path: path below the model's URL; None: the server's own URL.
            deadline_s: deadline, on the monotonic clock.
            headers: headers of the request.
            body: body of the request.

        Raises:
            ServerError: no usable answer.
        """
        url = f"{self._server.url.rstrip('/')}/v2"
        if path is not None:
            url += f"/models/{self._server.model}{path}"
        left_s = deadline_s - time.monotonic()
        exchange = CancellableRequest(link.connection)
        with self._lock:
            if self._closed:
                raise self._error("no connection", "it was closed")
            self._current_request = exchange
        try:
            if left_s <= 0.0:
                raise TimeoutError
            request = link.client.build_request(
                method, url, headers={**headers, "Accept-Encoding": "identity"}, content=body,
                timeout=left_s,
            )  # fmt: skip
            reply = exchange.send(link.client, request, MOST_BYTES, left_s)
        except RequestCancelledError:
            raise self._error("no connection", "it was closed") from None
        except (TimeoutError, httpx.TimeoutException):
            limit_s = self._server.time_limit_s
            what = (
                f"no complete answer within {limit_s:g} s; use a faster server, or raise "
                "time_limit_s"
            )
            raise self._error("timeout", what) from None
        except Exception as error:  # httpx wraps most, but not all, socket errors
            raise self._error("no connection", failure_reason(error)) from None
        finally:
            with self._lock:
                self._current_request = None
        if len(reply.body) > MOST_BYTES:
            raise self._error(
                "invalid answer", f"over {MOST_BYTES >> 20} MB; check what runs there"
            )
        if reply.status != 200:
            raise self._error("refused", _refusal(reply))
        return reply

    @contextlib.contextmanager
    def _check_answer(self) -> Iterator[None]:
        """Turn a ValueError within the block into a ServerError of kind `invalid answer`."""
        try:
            yield
        except ValueError as error:
            what = f"{one_line(error)}; check what runs there"
            raise self._error("invalid answer", what) from None

    def _error(self, kind: Fault, what: str) -> ServerError:
        """Return the error to raise, with the server in front."""
        return ServerError(self.name, self._server.url, kind, what)

    def _disconnect(self, is_waiting: bool) -> None:
        """Close the connection; the next request opens another.

        Args:
            is_waiting: True if a thread still waits for an answer on this connection. Cutting the
                connection ends that wait.
        """
        link, self._link = self._link, None
        if link is not None:
            link.connection.cut()
            if not is_waiting:  # the client is in use by the thread that waits
                link.client.close()


class KServeBoundSession:
    """A bound session of a server. Outputs are copied into arrays that it allocates once."""

    def __init__(
        self,
        session: KServeSession,
        inputs: Mapping[str, np.ndarray],
        outputs: Mapping[str, tuple[int, ...]],
    ) -> None:
        self._session, self._inputs, self._shapes = session, inputs, outputs
        self._outputs = [np.empty(shape, np.float32) for shape in outputs.values()]

    def run(self) -> Sequence[np.ndarray]:
        """See `BoundSession.run`; raises ServerError."""
        found = self._session.infer(self._inputs, self._shapes)
        for output, value in zip(self._outputs, found, strict=True):
            np.copyto(output, value)
        return self._outputs


class _ServerLink:
    """An HTTP client with one connection, which can be cut from another thread."""

    def __init__(self, url: str) -> None:
        # Load certificates only for https: reading them takes longer than a short answer.
        verify = ssl.create_default_context() if url.startswith("https:") else False
        limits = httpx.Limits(max_connections=1, max_keepalive_connections=1, keepalive_expiry=None)
        self.client = httpx.Client(verify=verify, trust_env=False, limits=limits)
        self.connection = CuttableConnection()


def _specs(values: Sequence[Value]) -> dict[str, tuple[str, messages.Shape]]:
    """Return datatype and shape by name; a size None means any, as None and -1 in `values`."""
    return {
        v.name: (_DATATYPES[v.dtype], tuple(s if s and s > 0 else None for s in v.shape or ()))
        for v in values
    }


def _refusal(reply: HttpReply) -> str:
    """Return the reason of an answer that is no success, for a message."""
    if 300 <= reply.status < 400:
        where = one_line(redact(reply.headers.get("Location", "nowhere")))
        return f"the server redirects to {where} (HTTP {reply.status}); configure the right URL"
    reason = explanation(reply.body)
    reason = reason.decode("utf-8", "replace") if isinstance(reason, bytes) else reason
    return f"HTTP {reply.status}: {one_line(reason) or 'it does not say why'}; see the server's log"
