"""Files over HTTP: resumed, measured against what they should be, never waited for forever.

Our own, since pooch begins anew after a break, and limits each read of a socket but not the whole.
"""

from __future__ import annotations

import contextlib
import re
import ssl
import threading
from collections.abc import Iterator
from dataclasses import dataclass

import httpx

from edge import __version__
from edge.host.bars import Bar
from edge.host.http import Connection, failure
from edge.models.part import MAX_BYTES, FetchError, Interrupted, Part
from edge.text import one_line, without_secrets

_HEADERS = {"User-Agent": f"edge-vln/{__version__}", "Accept-Encoding": "identity"}
_PASSING = {408, 425, 429, 500, 502, 503, 504}
"""HTTP errors that may be gone at the next try."""
_REDIRECTS = 10


@dataclass(frozen=True)
class Limits:
    """How long a server is waited for.

    Attributes:
        answer_s: the head of an answer must be there after so long, with all that comes before
            it: connecting, TLS, a proxy, redirects.
        slow_s, slow_bytes: content that comes slower than so many bytes in so long is given up.
        tries: connections to one address; each goes on where the last ended.
        small_s, small_bytes: of a small file, which must be there whole after so long.
        wheel_s: how long pip may take for a wheel.
    """

    answer_s: float = 30.0
    slow_s: float = 30.0
    slow_bytes: int = 1 << 15
    tries: int = 3
    small_s: float = 120.0
    small_bytes: int = 1 << 20
    wheel_s: float = 1800.0


LIMITS = Limits()


class _NoRange(Interrupted):
    """The server's file ends before the part does."""


def download(url: str, part: Part, limits: Limits = LIMITS) -> None:
    """Fetch a file into `part`, from where that ends, and put it in its place.

    Raises:
        FetchError: it cannot be had there, or is not what it should be.
    """
    part.ask_elsewhere()
    for tries_left in reversed(range(limits.tries)):
        try:
            if not part.is_whole():
                _fetch(url, part, limits)
            part.finish()
        except Interrupted as error:
            if not tries_left:
                raise FetchError(f"{shown(url)}: {error}") from None
        except FetchError as error:
            raise FetchError(f"{shown(url)}: {error}") from None
        else:
            return


def read_small(url: str, limits: Limits = LIMITS) -> bytes:
    """The content of a small file.

    Raises:
        FetchError: it cannot be had, or is no small file.
    """
    content = bytearray()
    try:
        with (
            _Watch(limits, limits.small_s) as watch,
            _answer(url, {}, watch, limits.answer_s) as response,
        ):
            for block in response.iter_raw():
                content += block
                if len(content) > limits.small_bytes:
                    raise FetchError(f"is longer than {limits.small_bytes} bytes")
    except FetchError as error:
        raise FetchError(f"{shown(url)}: {error}") from None
    return bytes(content)


def shown(url: str) -> str:
    """An address as messages may show it."""
    return one_line(without_secrets(url), 500)


def _fetch(url: str, part: Part, limits: Limits) -> None:
    """Bring what is missing of a part.

    Raises:
        Interrupted: another try may bring the rest.
        FetchError: none will.
    """
    wanted = {"Range": f"bytes={part.have}-"} if part.have else {}
    try:
        with (
            _Watch(limits) as watch,
            _answer(url, wanted, watch, limits.answer_s) as response,
        ):
            total = _agree_on_start(response, part)
            if total is not None and total > MAX_BYTES:
                raise FetchError(f"offers {total} bytes, more than any model has")
            if None not in (total, part.size) and total != part.size:
                raise FetchError(f"offers {total} bytes, the card says {part.size}")
            size = part.size if total is None else total
            with Bar(part.target.name, size, part.have, unit="B", unit_scale=True) as bar:
                for block in response.iter_raw():
                    part.write(block)
                    watch.came += len(block)
                    bar.reach(part.have)
    except _NoRange:
        part.restart()
        raise


def _agree_on_start(response: httpx.Response, part: Part) -> int | None:
    """Make `part` end where the response begins; bytes of the whole file, None if not told."""
    length = response.headers.get("Content-Length", "")
    if response.status_code == 206:
        told = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
        if told is None or int(told[1]) != part.have:
            part.restart()
            raise Interrupted("the server sent another range than was asked for")
        return int(told[2]) if told[2] != "*" else None
    if part.have:
        part.restart()  # it does not resume, and sends all of it
    return int(length) if length.isdecimal() else None


class _Watch:
    """Cuts the connection of a server that takes too long; a context, entered before the request.

    Its end raises Interrupted with the reason where the watch is why the request broke off.

    Attributes:
        connection: of the request.
        answered: to be set when the head of the answer is there.
        came: bytes of content until now, to be kept up to date.
    """

    def __init__(self, limits: Limits, whole_s: float | None = None) -> None:
        """
        Args:
            whole_s: the content must be there after so long; None: it must keep coming.
        """
        self.connection, self.answered, self.came = Connection(), threading.Event(), 0
        self._limits, self._whole_s, self._over = limits, whole_s, threading.Event()
        self._why = ""

    def __enter__(self) -> _Watch:
        threading.Thread(target=self._look, name="download watch", daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        self._over.set()
        self.answered.set()
        if self._why and (kind is None or issubclass(kind, Interrupted)):
            raise Interrupted(self._why) from None

    def _look(self) -> None:
        limits, before = self._limits, 0
        if not self.answered.wait(limits.answer_s):
            self._cut(f"no answer within {limits.answer_s:g} s")
        elif self._whole_s is not None:
            if not self._over.wait(self._whole_s):
                self._cut(f"not whole after {self._whole_s:g} s")
        else:
            while not self._over.wait(limits.slow_s):
                came, before = self.came - before, self.came
                if came < limits.slow_bytes:
                    return self._cut(f"only {came} bytes came in {limits.slow_s:g} s")

    def _cut(self, why: str) -> None:
        self._why = why
        self.connection.cut()


@contextlib.contextmanager
def _answer(
    url: str, headers: dict[str, str], watch: _Watch, connect_s: float
) -> Iterator[httpx.Response]:
    """An answer of 2xx, its content unread; raises FetchError, or Interrupted where another try
    may help, also for what goes wrong while the content is read."""
    try:
        with _client(connect_s) as client:
            request = client.build_request(
                "GET", url, headers={**_HEADERS, **headers},
                extensions={"trace": watch.connection.trace},
            )  # fmt: skip
            with contextlib.closing(_follow(client, request)) as response:
                watch.answered.set()
                _check_status(response)
                yield response
    except (httpx.InvalidURL, httpx.UnsupportedProtocol) as error:
        raise FetchError(f"is no address to ask ({one_line(error)})") from None
    except (httpx.ConnectError, UnicodeError) as error:
        raise FetchError(failure(error)) from None
    except httpx.HTTPError as error:
        raise Interrupted(failure(error)) from None


def _client(connect_s: float) -> httpx.Client:
    """With the system's certificates, through the proxies of the environment."""
    timeout = httpx.Timeout(None, connect=connect_s)
    try:
        return httpx.Client(timeout=timeout, verify=ssl.create_default_context())
    except (ImportError, ValueError) as error:
        raise FetchError(f"no proxy of the environment can be used ({one_line(error)})") from None


def _follow(client: httpx.Client, request: httpx.Request) -> httpx.Response:
    """The answer where all redirects end. Their content, which may be of any length, is not read,
    and a password is for the first address alone."""
    for _ in range(_REDIRECTS):
        response = client.send(request, stream=True)
        if response.next_request is None:
            return response
        response.close()
        request = response.next_request
        request.headers.pop("Authorization", None)
        request.url = request.url.copy_with(username=None, password=None)
    raise FetchError(f"HTTP {response.status_code}: more than {_REDIRECTS} redirects")


def _check_status(response: httpx.Response) -> None:
    if response.is_success:
        return
    if response.status_code == 416:
        raise _NoRange("the server has no such range")
    kind = Interrupted if response.status_code in _PASSING else FetchError
    raise kind(f"HTTP {response.status_code} {one_line(response.reason_phrase)}")
