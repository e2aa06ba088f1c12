"""Functions that parse outside text, make it safe to log, print or send, and format tables."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from typing import Any
from urllib.parse import SplitResult, urlsplit

MAX_CHARS = 200
"""Default limit of `one_line`."""

# Scheme, user and password, host and path, query and fragment: "https://me:pw@host/v1?key=42" has
# the groups "https://" and "host/v1". No scheme is longer than 32 characters. Without a limit, a
# long word would be scanned again from each of its letters.
_URL = re.compile(r"([a-zA-Z][a-zA-Z0-9+.-]{0,31}://)(?:[^\s/?#]*@)?([^\s?#]*)(?:[?#]\S*)?")
# A Zenoh endpoint: protocol and address. Metadata (`?`) and configuration (`#`) follow, which may
# hold a private key: "tls/host:7447#key=42" has the groups "tls/" and "host:7447".
_LOCATOR = re.compile(
    r"(?<![\w/])((?:tcp|udp|tls|quic|ws|serial|vsock|unixpipe|unixsock-stream)/)([^\s?#]*)[?#]\S*"
)
# White space with a line break or a tab in it: [^\S ] is any white space except a space.
_BREAK = re.compile(r" *[^\S ]\s*")
# The end of a key whose value is secret, such as "api_key" or "db_password".
_SECRET_KEY = re.compile(
    r"(pass(word|wd|phrase)?|secret|token|api_?key|private_key)$", re.IGNORECASE
)


def one_line(text: object, limit: int = MAX_CHARS) -> str:
    """Return one line without control characters, of at most `limit` characters.

    Text of a peer, a server or a file may hold line breaks that forge log lines, escapes that
    control a terminal, or megabytes. Each non-printable character becomes a space, and runs of
    spaces become one space. Text that is too long is cut and ends in `…`.

    >>> one_line("stuck\\n12:00 info mission:\\x1b[31m reached")
    'stuck 12:00 info mission: [31m reached'
    """
    # Only ten times the limit is read, so the cost does not grow with the text. `str` of an integer
    # or a container would build the entire text first; `bounded_repr` does not.
    is_data = type(text) is int or type(text) in _BRACKETS
    head = bounded_repr(text, 10 * limit) if is_data else str(text)[: 10 * limit]
    line = " ".join(_printable(head).split())
    return line if len(line) <= limit else line[: limit - 1] + "…"


def bounded_repr(value: object, limit: int = 80) -> str:
    """Return the `repr` of outside data, cut to `limit` characters; a cut text ends in `…`.

    The cost depends on `limit`, not on the data. `f"{value!r:.80}"` would build the entire text
    first, and would raise for an integer of more than 4300 digits.

    >>> bounded_repr({"a": [1, None, "x" * 9_000_000]}, 24)
    "{'a': [1, None, 'xxxxxx…"
    """
    line, pieces = "", _repr_pieces(value, limit)
    while len(line) <= limit and (piece := next(pieces, None)) is not None:
        line += piece
    return line if len(line) <= limit else line[: limit - 1] + "…"


# Container → its brackets in `repr`.
_BRACKETS: dict[type, tuple[str, str]] = {
    list: ("[", "]"), tuple: ("(", ")"), set: ("{", "}"), dict: ("{", "}")
}  # fmt: skip


def _repr_pieces(value: Any, limit: int) -> Iterator[str]:
    """Yield the pieces of `repr`, at least one character for each level of nesting."""
    if isinstance(value, (str, bytes)):
        yield repr(value[:limit])
    elif isinstance(value, int) and (unseen := value.bit_length() // 4 - limit) > 0:
        # A huge integer: its first `limit` hexadecimal digits, since decimal ones cost too much.
        yield ("-" if value < 0 else "") + hex(abs(value) >> 4 * unseen)
    elif (brackets := _BRACKETS.get(type(value))) is not None:
        yield brackets[0]
        for k, item in enumerate(value):
            if k:
                yield ", "
            yield from _repr_pieces(item, limit)
            if isinstance(value, dict):
                yield ": "
                yield from _repr_pieces(value[item], limit)
        yield brackets[1]
    else:
        yield repr(value)


def shorten(text: str, length: int) -> str:
    """Return printable text of at most `length` characters, with its spaces kept.

    A non-printable character becomes `�`. A line break and the spaces around it become one space,
    because an instruction may have several lines.

    >>> shorten("tall white trash can", 10)
    'tall whit…'
    >>> shorten("go to the bed,\\n    then  to the tv", 40)
    'go to the bed, then  to the tv'
    """
    text = "".join(c if c.isprintable() else "�" for c in _BREAK.sub(" ", text))
    return text if len(text) <= length else f"{text[: length - 1]}…"


def printable_lines(text: object) -> str:
    """Return a text of `edge` without control characters; its line breaks stay.

    The text may quote text from outside.

    >>> printable_lines("robot.yaml: one fault\\nrobot.yaml: \\x1b[2J")
    'robot.yaml: one fault\\nrobot.yaml:  [2J'
    """
    return "\n".join(map(_printable, str(text).splitlines()))


def bounded_lines(text: str, limit: int) -> str:
    """Return multi-line outside text without control characters, of at most `limit` characters.

    Text that is too long is cut and ends in `…`.

    >>> bounded_lines("a = 1\\nb\\x1b[2J = 2", 11)
    'a = 1\\nb [2…'
    """
    cut = printable_lines(text[:limit].replace("\t", "    "))
    return cut if len(text) <= limit and len(cut) <= limit else cut[: limit - 1] + "…"


def _printable(text: str) -> str:
    if text.isprintable():  # nearly always true, and a hundred times faster
        return text
    return "".join(c if c.isprintable() else " " for c in text)


def read_json(text: bytes | str, max_values: int | None = None) -> Any:
    """Return the data of JSON text from outside.

    Args:
        text: The JSON text.
        max_values: Largest number of commas and opening brackets, an estimate of the number of
            values; None: no limit. A parsed value takes about twenty times the memory of its text.

    Raises:
        ValueError: The text is not JSON, is nested too deeply, or has too many values.
    """
    if max_values is not None:
        marks = (b",", b"[", b"{") if isinstance(text, bytes) else (",", "[", "{")
        if sum(map(text.count, marks)) > max_values:
            raise ValueError(f"more than {max_values} values, which is not allowed")
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError("not JSON") from None


def read_json_object(text: bytes | str, max_bytes: int | None = None) -> dict[str, Any]:
    """Return the object in JSON text from outside.

    Raises:
        ValueError: The text is not a JSON object, or is longer than `max_bytes`. The message is
            one line.
    """
    if max_bytes is not None and len(text) > max_bytes:
        raise ValueError(f"{len(text)} bytes, at most {max_bytes} are accepted")
    data = read_json(text)
    if not isinstance(data, dict):
        raise ValueError("not a JSON object")
    return data


def split_url(url: str, server: str, advice: str) -> SplitResult:
    """Return the parts of a server's URL.

    Raises:
        ValueError: It is not a URL, or it holds a password. The message is one line that shows no
            secret.
    """
    try:
        parts = urlsplit(url)
        parts.port  # noqa: B018 - raises if it is not a number
    except ValueError:
        shown = one_line(redact(url))
        raise ValueError(f"not the URL of {server}: {shown!r}; {advice}") from None
    if parts.username is not None or parts.password is not None:
        raise ValueError(f"the URL of {server} must not hold a password; {advice}")
    usable = parts.scheme in ("http", "https") and parts.hostname and url.isprintable()
    if not usable or " " in url or not url.isascii():
        shown = one_line(redact(url))
        raise ValueError(f"not the URL of {server}: {shown!r}; {advice}")
    return parts


def format_table(rows: Sequence[Sequence[object]], left: int | None = None) -> str:
    """Return a text table with columns as wide as their widest cell.

    The first `left` columns (default: all) are left-aligned, the others right-aligned.

    >>> format_table([["name", "n"], ["chair", 3], ["tv", 12]], left=1)
    'name    n\\nchair   3\\ntv     12'
    """
    texts = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    left = len(widths) if left is None else left
    return "\n".join(
        "  ".join(
            text.ljust(width) if k < left else text.rjust(width)
            for k, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in texts
    )


def redact(data: Any, depth: int = 100) -> Any:
    """Return the data with possible secrets replaced by `***`.

    Removed are the user, password, query and fragment of a URL, everything after the address of a
    Zenoh endpoint, and each value under a key such as `password`, `token` or `api_key`.

    Args:
        data: Text, or JSON types that hold text. Keys of objects are not changed.
        depth: Levels of nesting to keep. Deeper data becomes `…`.

    >>> redact({"url": "https://me:pw@host/v1?key=42", "n": [1, "a://b"]})
    {'url': 'https://host/v1?***', 'n': [1, 'a://b']}
    >>> redact({"endpoint": "tls/host:7447#connect_private_key_base64=42", "token": "42"})
    {'endpoint': 'tls/host:7447?***', 'token': '***'}
    """
    if isinstance(data, str):
        return _LOCATOR.sub(r"\1\2?***", _URL.sub(_without_secrets, data))
    if not isinstance(data, (dict, list, tuple)):
        return data
    if depth == 0:
        return "…"
    if isinstance(data, dict):
        return {
            key: "***" if value and _SECRET_KEY.search(str(key)) else redact(value, depth - 1)
            for key, value in data.items()
        }
    return [redact(value, depth - 1) for value in data]


def _without_secrets(url: re.Match[str]) -> str:
    """Return a URL without user and password, and with `***` for its query and fragment."""
    scheme, place = url.groups()
    rest = url[0][url.end(2) - url.start() :]  # after the host and path
    return f"{scheme}{place}{'?***' if rest else ''}"
