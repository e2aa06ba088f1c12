"""Client for OpenAI-compatible chat servers, for the translator `llm`, scorers and task writer.

It follows no redirects and no proxy settings of the environment, so the API key goes to the
configured server only. The package `openai` is not used because it limits only each read of a
socket, not the size of an answer or its total time.
"""

from __future__ import annotations

import json
import os
import re
import ssl
import threading
from typing import Any
from urllib.parse import SplitResult

import httpx

from edge.config import ChoiceOpenai, ChoiceText, TranslatorLlm, WriterModel
from edge.errors import UnavailableError
from edge.host.http import (
    CancellableRequest,
    HttpReply,
    RequestCancelledError,
    explanation,
    failure_reason,
)
from edge.text import bounded_repr, one_line, split_url

MAX_ANSWER_BYTES = 256 * 1024  # limit of an HTTP body
MOST_TOKENS = 20  # most log-probabilities that OpenAI and vLLM return for one position
ROUNDING = 1e-3  # tolerance of a log-probability above 0
LIFE_PERIOD_S, LIFE_S = 0.5, 1.0  # between two short requests, and for the answer to one
LEAST = -1e4  # lower bound; for "impossible", OpenAI and vLLM return -9999, llama.cpp -3e38


class ChatError(UnavailableError):
    """An error of a chat server; the message has the server, the problem and the remedy."""


class TokenLimitError(ChatError):
    """The model reached the token limit before the end of its answer.

    Attributes:
        answer: the text up to the limit.
    """

    def __init__(self, message: str, answer: str) -> None:
        super().__init__(message)
        self.answer = answer


class _NoLifeError(Exception):
    """The server does not even answer a short request."""


class ChatTimeoutError(ChatError):
    """The complete answer did not arrive within the time limit."""


class ChatClient:
    """Client for one model on one server.

    Args:
        url: base URL of the API, such as `http://127.0.0.1:8080/v1`; requests go to
            `{url}/chat/completions`.
        api_key: sent as a bearer token and never shown; None or empty sends none.
        time_limit_s: limit for one request in total: name lookup, connection and answer.
        max_answer_bytes: limit of the HTTP body; a longer answer is refused.
        must_live: True: during a request, the server must answer `GET {url}/models`, with any
            status, within `LIFE_S`. So a server that hangs is found within 2 s, while one that
            thinks has `time_limit_s`.

    Raises:
        ChatError: the URL or the key cannot be used.

    Example:
        >>> client = ChatClient("http://127.0.0.1:8080/v1", "my-model", time_limit_s=5.0)
        >>> client
        ChatClient('http://127.0.0.1:8080/v1', 'my-model')
        >>> answer = client.ask([{"role": "user", "content": "Hello"}])  # doctest: +SKIP
        >>> client.close()
    """

    def __init__(
        self,
        url: str,
        model: str,
        api_key: str | None = None,
        time_limit_s: float = 30.0,
        max_answer_bytes: int = MAX_ANSWER_BYTES,
        must_live: bool = False,
    ) -> None:
        parts = _split(url)
        self.url = parts._replace(query="", fragment="").geturl()  # a query may hold a secret
        self.model, self.time_limit_s, self.max_answer_bytes = model, time_limit_s, max_answer_bytes
        self._must_live = must_live
        self._parts, self._api_key = parts, (api_key or "").strip()
        self._lock, self._closed = threading.Lock(), False
        # Reading the certificates takes longer than a short answer, so it is done only once.
        verify = ssl.create_default_context() if parts.scheme == "https" else False
        limits = httpx.Limits(max_keepalive_connections=0)
        self._http = httpx.Client(verify=verify, trust_env=False, limits=limits)
        self._under_way: set[CancellableRequest] = set()
        if not re.fullmatch(r"[\x21-\x7e]*", self._api_key):  # printable ASCII without spaces
            raise ChatError(
                f"{self.url}: the API key has characters that no HTTP header can have; "
                "set a valid key"
            )

    def ask(
        self, messages: list[dict[str, Any]], left_s: float | None = None, **options: Any
    ) -> str:
        """Return the model's answer to a conversation.

        Args:
            messages: dicts `{"role": "system" | "user" | "assistant", "content": …}`. The content
                is a text, or a list of parts: texts, and images as `image_url`.
            left_s: remaining time, if earlier requests used part of the time limit; None: all of
                it.
            options: further fields of the request, such as `temperature`.

        Raises:
            ChatError: no usable answer within the limits; `TokenLimitError` if the token limit
                ended the answer.
        """
        return self._parse_content(self._reply(messages, left_s, options))

    def next_tokens(
        self, messages: list[dict[str, Any]], left_s: float | None = None, **options: Any
    ) -> list[tuple[str, float]]:
        """Return the most likely first tokens of the answer, with their log-probabilities.

        One token is requested, with temperature 1. So the logits are the model's own, even if a
        server divides them by the temperature before it reports them. The request has no field for
        prompt caching: vLLM and llama.cpp cache without one, and hosted servers refuse unknown
        fields.

        Returns:
            At most about `MOST_TOKENS` pairs; the log-probabilities are at most 0, not NaN.

        Raises:
            ChatError: no usable answer within the limits, or one without log-probabilities.
        """
        defaults = {
            "max_tokens": 1,
            "temperature": 1,
            "logprobs": True,
            "top_logprobs": MOST_TOKENS,
        }
        return self._parse_log_probabilities(self._reply(messages, left_s, {**defaults, **options}))

    def close(self) -> None:
        """Cancel running requests at once; later requests fail."""
        with self._lock:
            self._closed, running = True, tuple(self._under_way)
        for exchange in running:
            exchange.cancel(RequestCancelledError())

    def _reply(
        self, messages: list[dict[str, Any]], left_s: float | None, options: dict[str, Any]
    ) -> HttpReply:
        """Send a request and return its reply; for arguments and errors see `ask`."""
        left_s = self.time_limit_s if left_s is None else left_s
        if left_s <= 0:
            raise self._timeout_error()
        request = {"model": self.model, "messages": messages, "stream": False, **options}
        reply = self._exchange(json.dumps(request).encode(), left_s)
        if 300 <= reply.status < 400:
            where = self._quote(reply.headers.get("Location", "nowhere"))
            raise self._error(
                f"the server redirects to {where} (HTTP {reply.status}); configure the right URL"
            )
        if reply.status != 200:
            raise self._error(
                f"the server answered HTTP {reply.status}{self._explanation(reply.body)}"
            )
        if len(reply.body) > self.max_answer_bytes:
            limit_kb = self.max_answer_bytes / 1024
            raise self._error(f"the answer has more than {limit_kb:g} KB; is it a chat server?")
        return reply

    def _exchange(self, body: bytes, left_s: float) -> HttpReply:
        """Send the body and return the reply, of any HTTP status; `close` cancels it."""
        exchange, request = CancellableRequest(), self._request(body, left_s)
        with self._lock:
            if self._closed:
                raise self._error(_reason(RequestCancelledError()))
            self._under_way.add(exchange)
        answered = threading.Event()
        if self._must_live:
            watch = (exchange, answered)
            threading.Thread(target=self._watch_life, args=watch, name="http", daemon=True).start()
        try:
            return exchange.send(self._http, request, self.max_answer_bytes, left_s)
        except (TimeoutError, httpx.TimeoutException):
            raise self._timeout_error() from None
        except Exception as error:
            raise self._error(_reason(error)) from None
        finally:
            answered.set()
            with self._lock:
                self._under_way.discard(exchange)

    def _watch_life(self, exchange: CancellableRequest, answered: threading.Event) -> None:
        """Cancel a request when the server stops answering short ones; see `must_live`."""
        path = f"{self._parts.path.rstrip('/')}/models"
        url = self._parts._replace(path=path, fragment="").geturl()
        while not answered.wait(LIFE_PERIOD_S):
            request = self._http.build_request("GET", url, headers=self._key(), timeout=LIFE_S)
            try:
                CancellableRequest().send(self._http, request, self.max_answer_bytes, LIFE_S)
            except Exception:
                exchange.cancel(_NoLifeError())
                return

    def _request(self, body: bytes, left_s: float) -> httpx.Request:
        """Return the HTTP request for a body, with a timeout for each step of it."""
        parts = self._parts
        url = parts._replace(path=f"{parts.path.rstrip('/')}/chat/completions", fragment="")
        headers = {
            "Content-Type": "application/json", "Accept": "application/json",
            "Accept-Encoding": "identity",
        }  # fmt: skip
        return self._http.build_request(
            "POST", url.geturl(), content=body, headers={**headers, **self._key()}, timeout=left_s
        )

    def _key(self) -> dict[str, str]:
        """Return the HTTP header with the API key, if there is one."""
        return {"Authorization": f"Bearer {self._api_key}"} if self._api_key else {}

    def _parse_content(self, reply: HttpReply) -> str:
        """Return the text of the answer; for errors see `ask`."""
        answer, shown = self._parse_json(reply), self._quote(reply.body)
        try:
            choice = answer["choices"][0]
            content, ended_by = choice["message"]["content"], choice.get("finish_reason")
            expected = content is None or isinstance(content, str)
        except (TypeError, KeyError, IndexError, AttributeError):
            expected = False
        if not expected:
            raise self._error(
                f"the answer has no choices[0].message.content: {shown!r}; is it a chat server?"
            )
        if ended_by == "length":
            error = f"{self.url}: the answer was cut off at the token limit; use another model"
            raise TokenLimitError(error, content or "")
        if not content or not content.strip():
            raise self._error("the answer is empty; try another model")
        return content

    def _parse_log_probabilities(self, reply: HttpReply) -> list[tuple[str, float]]:
        """Return (token, log-probability) of the first token's alternatives; see `next_tokens`."""
        answer = self._parse_json(reply)
        try:
            found = answer["choices"][0]["logprobs"]["content"][0]["top_logprobs"]
            pairs = [(entry["token"], entry["logprob"]) for entry in found]
        except (TypeError, KeyError, IndexError):
            pairs = []
        if not pairs:
            raise self._error(
                "the answer has no logprobs (choices[0].logprobs.content[0].top_logprobs); "
                "use a server and a model that support them"
            )
        for token, logprob in pairs:
            number = isinstance(logprob, (int, float)) and not isinstance(logprob, bool)
            if not (isinstance(token, str) and number and logprob <= ROUNDING):  # false for NaN
                shown = self._quote(f"{bounded_repr(token, 40)}: {bounded_repr(logprob, 40)}")
                raise self._error(
                    f"the answer has an invalid logprob, {shown}; expected a number of 0 or less; "
                    "check the server"
                )
        return [(token, float(max(logprob, LEAST))) for token, logprob in pairs]

    def _parse_json(self, reply: HttpReply) -> Any:
        try:
            return json.loads(reply.body)
        except (ValueError, RecursionError):
            shown = self._quote(reply.body)
            kind = self._quote(reply.headers.get("Content-Type", "no Content-Type"))
            raise self._error(
                f"the answer is not JSON ({kind}): {shown!r}; is it a chat server?"
            ) from None

    def _explanation(self, body: bytes) -> str:
        """Return the server's explanation of an HTTP error, or advice if there is none."""
        shown = self._quote(explanation(body))
        return f": {shown}" if shown else "; see the server's log"

    def _quote(self, text: str | bytes) -> str:
        """Return one short printable line of the server's text, with the API key masked."""
        text = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
        text = text.replace(self._api_key, "***") if self._api_key else text
        return one_line(text)

    def _error(self, what: str) -> ChatError:
        return ChatError(f"{self.url}: {what}")

    def _timeout_error(self) -> ChatTimeoutError:
        return ChatTimeoutError(
            f"{self.url}: no complete answer within {self.time_limit_s:g} s; raise time_limit_s or "
            "use a faster model"
        )

    def __repr__(self) -> str:
        return f"ChatClient({self.url!r}, {self.model!r})"


def _split(url: str) -> SplitResult:
    try:
        return split_url(url, "a chat server", "give it as http://HOST:PORT/v1")
    except ValueError as error:
        raise ChatError(str(error)) from None


def _reason(error: Exception) -> str:
    """Return the problem and the remedy; raise an error that is none of the network's again."""
    match error:
        case RequestCancelledError():
            return "cancelled: the client is closed"
        case _NoLifeError():
            return "the server hangs: it does not answer even a short request; see its log"
        case httpx.HTTPError() | UnicodeError():
            return failure_reason(error)
    raise error


def make_chat_client(
    config: TranslatorLlm | WriterModel | ChoiceOpenai | ChoiceText, must_live: bool = False
) -> ChatClient:
    """Return the client that a configuration describes; the API key comes from the environment.

    `must_live`: see `ChatClient`.

    Raises:
        ChatError: the URL or the key cannot be used.
    """
    api_key = os.environ.get(config.api_key_env)
    return ChatClient(config.url, config.model, api_key, config.time_limit_s, must_live=must_live)
