"""Downloads over HTTP that can be resumed, are verified, and end in limited time.

The package pooch is not used: it starts again after a broken connection, and limits only each read
of a socket.
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
from edge.host.http import CuttableConnection, failure_reason
from edge.host.progress import ProgressBar
from edge.models.partial_file import MAX_BYTES, FetchError, InterruptedFetchError, PartialFile
from edge.text import one_line, redact

_HEADERS = {"User-Agent": f"edge-vln/{__version__}", "Accept-Encoding": "identity"}
_RETRY_STATUS = {408, 425, 429, 500, 502, 503, 504}
"""HTTP errors that are worth another try."""
_REDIRECTS = 10  # most redirects of one request


@dataclass(frozen=True)
class DownloadLimits:
    """Time limits of downloads.

    Attributes:
        answer_s: time until the header of the response, including connection, TLS, proxy and
            redirects.
        slow_s: period for `slow_bytes`.
        slow_bytes: a download that gets fewer bytes in `slow_s` is stopped.
        tries: attempts per address; each resumes where the one before ended.
        small_s: time for an entire small file.
        small_bytes: largest small file.
    """

    answer_s: float = 30.0
    slow_s: float = 30.0
    slow_bytes: int = 1 << 15
    tries: int = 3
    small_s: float = 120.0
    small_bytes: int = 1 << 20
    wheel_s: float = 1800.0


LIMITS = DownloadLimits()


class _NoRangeError(InterruptedFetchError):
    """The file on the server is shorter than the partial file."""


def download(url: str, part: PartialFile, limits: DownloadLimits = LIMITS) -> None:
    """Download a file into `part`, resume where it ends, verify it, and move it to its place.

    Raises:
        FetchError: the download failed, or the file has another hash or size.
    """
    part.mark_resumed()
    for tries_left in reversed(range(limits.tries)):
        try:
            if not part.is_complete():
                _fetch(url, part, limits)
            part.finish()
        except InterruptedFetchError as error:
            if not tries_left:
                raise FetchError(f"{printable_url(url)}: {error}") from None
        except FetchError as error:
            raise FetchError(f"{printable_url(url)}: {error}") from None
        else:
            return


def read_small(url: str, limits: DownloadLimits = LIMITS) -> bytes:
    """Download a small file, and return its content.

    Raises:
        FetchError: the download failed, or the file is too large.
    """
    content = bytearray()
    try:
        with (
            _SpeedWatch(limits, limits.small_s) as watch,
            _open_response(url, {}, watch, limits.answer_s) as response,
        ):
            for block in response.iter_raw():
                content += block
                if len(content) > limits.small_bytes:
                    raise FetchError(f"the file is longer than {limits.small_bytes} bytes")
    except FetchError as error:
        raise FetchError(f"{printable_url(url)}: {error}") from None
    return bytes(content)


def printable_url(url: str) -> str:
    """Return an address for messages: one line, without secrets."""
    return one_line(redact(url), 500)


def _fetch(url: str, part: PartialFile, limits: DownloadLimits) -> None:
    """Download the rest of a partial file.

    Raises:
        InterruptedFetchError: another try may succeed.
        FetchError: another try will not succeed.
    """
    headers = {"Range": f"bytes={part.have}-"} if part.have else {}
    try:
        with (
            _SpeedWatch(limits) as watch,
            _open_response(url, headers, watch, limits.answer_s) as response,
        ):
            total = _agree_on_start(response, part)
            if total is not None and total > MAX_BYTES:
                raise FetchError(f"the file there has {total} bytes, over the limit of {MAX_BYTES}")
            if total is not None and part.size is not None and total != part.size:
                raise FetchError(
                    f"the file there has {total} bytes, but the model card says {part.size}: "
                    "another file or version; choose another place with --from"
                )
            size = part.size if total is None else total
            with ProgressBar(part.target.name, size, part.have, unit="B", unit_scale=True) as bar:
                for block in response.iter_raw():
                    part.write(block)
                    watch.n_bytes += len(block)
                    bar.set_done(part.have)
    except _NoRangeError:
        part.restart()
        raise


def _agree_on_start(response: httpx.Response, part: PartialFile) -> int | None:
    """Make `part` end where the response begins; return the entire file's size, None if unknown.

    A server may ignore the requested range, and send the file from its start: `part` is then
    emptied.

    Raises:
        InterruptedFetchError: the response begins elsewhere; `part` is emptied.
    """
    length = response.headers.get("Content-Length", "")
    if response.status_code == 206:
        # "bytes 100-199/5000": first and last byte that were sent, and the size of the file or "*".
        sent = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
        if sent is None or int(sent[1]) != part.have:
            part.restart()
            raise InterruptedFetchError("the server sent another part of the file than requested")
        return int(sent[2]) if sent[2] != "*" else None
    if part.have:
        part.restart()  # the server does not resume, and sends the entire file
    return int(length) if length.isdecimal() else None


class _SpeedWatch:
    """Context that cuts the connection of a slow server; enter it before the request.

    If it cut the connection, the end of the context raises InterruptedFetchError with the reason.

    Args:
        total_s: time for the entire content; None: only its speed is limited, see `DownloadLimits`.

    Attributes:
        has_header: set it when the header of the response has come.
        n_bytes: number of content bytes so far; keep it up to date.
    """

    def __init__(self, limits: DownloadLimits, total_s: float | None = None) -> None:
        self.connection, self.has_header, self.n_bytes = CuttableConnection(), threading.Event(), 0
        self._limits, self._total_s, self._ended = limits, total_s, threading.Event()
        self._why = ""

    def __enter__(self) -> _SpeedWatch:
        threading.Thread(target=self._watch, name="download watch", daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        self._ended.set()
        self.has_header.set()  # wakes the watch thread
        if self._why and (kind is None or issubclass(kind, InterruptedFetchError)):
            raise InterruptedFetchError(self._why) from None

    def _watch(self) -> None:
        """Wait for the header, then for the content; runs on a thread of its own."""
        limits, before = self._limits, 0
        if not self.has_header.wait(limits.answer_s):
            self._cut(f"no answer within {limits.answer_s:g} s")
        elif self._total_s is not None:
            if not self._ended.wait(self._total_s):
                self._cut(f"not complete after {self._total_s:g} s")
        else:
            while not self._ended.wait(limits.slow_s):
                came, before = self.n_bytes - before, self.n_bytes
                if came < limits.slow_bytes:
                    return self._cut(f"only {came} bytes came in {limits.slow_s:g} s")

    def _cut(self, why: str) -> None:
        """Cut the connection, for a reason that the end of the context raises."""
        self._why = why
        self.connection.cut()


@contextlib.contextmanager
def _open_response(
    url: str, headers: dict[str, str], watch: _SpeedWatch, connect_s: float
) -> Iterator[httpx.Response]:
    """Yield a response of status 2xx, before its content is read.

    Raises:
        InterruptedFetchError: another try may succeed; also for errors while the content is read.
        FetchError: another try will not succeed.
    """
    try:
        with _client(connect_s) as client:
            request = client.build_request(
                "GET", url, headers={**_HEADERS, **headers},
                extensions={"trace": watch.connection.trace},
            )  # fmt: skip
            with contextlib.closing(_follow(client, request)) as response:
                watch.has_header.set()
                _check_status(response)
                yield response
    except (httpx.InvalidURL, httpx.UnsupportedProtocol) as error:
        raise FetchError(f"not a valid address ({one_line(error)})") from None
    except (httpx.ConnectError, UnicodeError) as error:
        raise FetchError(failure_reason(error)) from None
    except httpx.HTTPError as error:
        raise InterruptedFetchError(failure_reason(error)) from None


def _client(connect_s: float) -> httpx.Client:
    """Return a client with the system's certificates and the proxies of the environment."""
    timeout = httpx.Timeout(None, connect=connect_s)
    try:
        return httpx.Client(timeout=timeout, verify=ssl.create_default_context())
    except (ImportError, ValueError) as error:
        raise FetchError(
            f"the proxy in the environment variables cannot be used ({one_line(error)})"
        ) from None


def _follow(client: httpx.Client, request: httpx.Request) -> httpx.Response:
    """Follow redirects, and return the last response.

    The content of redirects is not read, since it may be of any length. The password is sent only
    to the first address.
    """
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
    """Raise FetchError, or InterruptedFetchError if another try may help, unless all is well."""
    if response.is_success:
        return
    if response.status_code == 416:
        raise _NoRangeError("the file on the server is shorter than the part already downloaded")
    kind = InterruptedFetchError if response.status_code in _RETRY_STATUS else FetchError
    raise kind(f"HTTP {response.status_code} {one_line(response.reason_phrase)}")
