"""Files over HTTP: resumed, measured against what they should be, never waited for forever."""

from __future__ import annotations

import base64
import http.client
import re
import urllib.error
import urllib.request
from typing import Any
from urllib.parse import SplitResult, unquote, urlsplit, urlunsplit

from edge import __version__
from edge.models.meter import Meter
from edge.models.pace import LIMITS, Limits, Pace, connecting
from edge.models.part import MAX_BYTES, FetchError, Interrupted, Part
from edge.text import one_line, without_secrets

_BLOCK = 1 << 16
_PASSING = {408, 425, 429, 500, 502, 503, 504}
"""HTTP errors that may be gone at the next try."""


class NoRange(Interrupted):
    """The server's file ends before the part does."""


def download(url: str, part: Part, limits: Limits = LIMITS) -> None:
    """Fetch a file into `part`, from where that ends, and put it in its place.

    Raises:
        FetchError: it cannot be had there, or is not what it should be.
    """
    part.ask_elsewhere()
    for tries_left in reversed(range(limits.tries)):
        try:
            with Meter(part.target.name, part.have) as meter:
                if not part.is_whole():
                    _stream(url, part, limits, meter)
            part.finish()
        except Interrupted as error:
            if not tries_left:
                raise FetchError(f"{shown(url)}: {error}") from None
        except FetchError as error:
            raise FetchError(f"{shown(url)}: {error}") from None
        else:
            return


def read_page(url: str, accept: str, limits: Limits = LIMITS) -> tuple[str, str, bytes]:
    """A small file, whole: (address after redirects, content type, content).

    Raises:
        FetchError: it cannot be had, or is no small file.
    """
    pace = Pace(limits, limits.page_s)
    try:
        with _open(url, {"Accept": accept}, pace) as response:
            content = _read_all(response, pace, limits)
            return response.geturl(), response.headers.get_content_type(), content
    except FetchError as error:
        raise FetchError(f"{shown(url)}: {error}") from None


def shown(url: str) -> str:
    """An address as messages may show it."""
    return one_line(without_secrets(url), 500)


def _stream(url: str, part: Part, limits: Limits, meter: Meter) -> None:
    pace = Pace(limits)
    try:
        response = _open(url, {"Range": f"bytes={part.have}-"} if part.have else {}, pace)
    except NoRange:
        part.restart()
        raise
    with response:
        total = _agree_on_start(response, part)
        if total is not None and total > MAX_BYTES:
            raise FetchError(f"offers {total} bytes, more than any model has")
        if None not in (total, part.size) and total != part.size:
            raise FetchError(f"offers {total} bytes, the card says {part.size}")
        for block in _blocks(response, pace):
            part.write(block)
            meter.update(part.have, part.size if total is None else total)
        if total is not None and part.have < total:
            raise Interrupted(f"the connection ended after {part.have} of {total} bytes")


def _agree_on_start(response: Any, part: Part) -> int | None:
    """Make `part` end where the response begins; bytes of the whole file, None if not told."""
    length = response.headers.get("Content-Length", "")
    if response.status == 206:
        told = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
        if told is None or int(told[1]) != part.have:
            part.restart()
            raise Interrupted("the server sent another range than was asked for")
        return int(told[2]) if told[2] != "*" else None
    if part.have:
        part.restart()  # it does not resume, and sends all of it
    return int(length) if length.isdecimal() else None


def _open(url: str, headers: dict[str, str], pace: Pace) -> Any:
    """A response of 2xx; raises FetchError, or Interrupted where another try may help."""
    try:
        split = urlsplit(url)
    except ValueError as error:
        raise FetchError(f"no address: {error}") from None
    plain = urlunsplit(split._replace(netloc=_host(split)))
    agent = {"User-Agent": f"edge-vln/{__version__}", "Accept-Encoding": "identity"}
    request = urllib.request.Request(plain, headers={**agent, **headers})
    if split.username is not None:  # for this host only, not where it redirects to
        user = f"{unquote(split.username)}:{unquote(split.password or '')}"
        token = base64.b64encode(user.encode()).decode()
        request.add_unredirected_header("Authorization", f"Basic {token}")
    try:
        response = _opener(pace).open(request, timeout=pace.left_s)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code == 416:
            raise NoRange("the server has no such range") from None
        kind = Interrupted if error.code in _PASSING else FetchError
        raise kind(f"HTTP {error.code} {_reason(error.reason)}") from None
    except urllib.error.URLError as error:
        if isinstance(error.reason, TimeoutError):
            raise pace.no_answer() from None
        raise FetchError(_reason(error.reason)) from None
    except TimeoutError:
        raise pace.no_answer() from None
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise Interrupted(_reason(error)) from None
    pace.answered()
    return response


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Follows redirects without their content, which may be of any length."""

    def http_error_302(self, req, fp, code, msg, headers):  # type: ignore[no-untyped-def]
        fp.close()  # the base class would read it to its end
        return super().http_error_302(req, fp, code, msg, headers)

    http_error_301 = http_error_303 = http_error_307 = http_error_308 = http_error_302


class _Http(urllib.request.HTTPHandler):
    def __init__(self, pace: Pace) -> None:
        super().__init__()
        self._pace = pace

    def http_open(self, req):  # type: ignore[no-untyped-def]
        return self.do_open(connecting(http.client.HTTPConnection, self._pace), req)


class _Https(urllib.request.HTTPSHandler):
    def __init__(self, pace: Pace) -> None:
        super().__init__()
        self._pace = pace

    def https_open(self, req):  # type: ignore[no-untyped-def]
        return self.do_open(connecting(http.client.HTTPSConnection, self._pace), req)


def _opener(pace: Pace) -> urllib.request.OpenerDirector:
    """HTTP and HTTPS alone, also after a redirect, through the proxies of the environment."""
    opener = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler(),
        _Http(pace),
        _Https(pace),
        urllib.request.HTTPDefaultErrorHandler(),
        _Redirects(),
        urllib.request.HTTPErrorProcessor(),
        urllib.request.UnknownHandler(),
    ):
        opener.add_handler(handler)
    return opener


def _blocks(response: Any, pace: Pace):  # type: ignore[no-untyped-def]
    """What the response brings, until its end; raises Interrupted when it stalls or breaks."""
    while True:
        try:
            block = response.read1(_BLOCK)
        except TimeoutError:
            raise pace.nothing_came() from None
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise Interrupted(_reason(error)) from None
        if not block:
            return
        yield block
        pace.took(len(block))


def _read_all(response: Any, pace: Pace, limits: Limits) -> bytes:
    content = bytearray()
    for block in _blocks(response, pace):
        content += block
        if len(content) > limits.page_bytes:
            raise FetchError(f"is longer than {limits.page_bytes} bytes")
    return bytes(content)


def _host(split: SplitResult) -> str:
    return split.netloc.rpartition("@")[2]


def _reason(error: object) -> str:
    """A socket's error in words."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return one_line(text)
