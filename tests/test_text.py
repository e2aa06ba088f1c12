import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.text import bounded_repr, one_line, read_json_object, redact


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("", ""),
        (" \n\t ", ""),
        ("no way to the goal", "no way to the goal"),
        ("stuck\r\n12:00:00.000 info mission: reached", "stuck 12:00:00.000 info mission: reached"),
        ("\x1b]0;owned\x07 \x00\x7f\x9b31m", "]0;owned 31m"),
        ("right\u202eleft\u2028next\u200b", "right left next"),
        ("lone \ud800 surrogate", "lone surrogate"),
        ("Küche 台所 🛋", "Küche 台所 🛋"),
        (ValueError("bad\nnews"), "bad news"),
        ("x" * 201, "x" * 199 + "…"),
        ("x" * 200, "x" * 200),
    ],
)
def test_one_line(said, shown):
    assert one_line(said) == shown


@given(st.text(max_size=500), st.integers(1, 300))
def test_one_line_is_printable_short_and_stable(text, limit):
    line = one_line(text, limit)
    assert line.isprintable()
    assert len(line) <= limit
    assert one_line(line, limit) == line


class Silent:
    def __repr__(self) -> str:
        raise AssertionError("what is not shown is not looked at")


def deep(levels: int) -> list:
    inner: list = []
    for _ in range(levels):
        inner = [inner]
    return inner


@pytest.mark.parametrize(
    "value",
    [None, True, 0, -1.5, "a", "it's", b"\x00", [], (), {}, [1, "b", None], (1, 2), {"a": [1]},
     {1: {"b": (2.5, "c")}}, {3}, {"k": -1}],
)  # fmt: skip
def test_short_values_are_shown_unchanged(value):
    assert bounded_repr(value) == repr(value)


@pytest.mark.parametrize(
    ("value", "begins"),
    [
        (["x" * 1000, Silent()], "['xxx"),
        ({"a": "x" * 1000, "b": Silent()}, "{'a': 'xxx"),
        ([0] * 1000 + [Silent()], "[0, 0, 0"),
        ("x" * 10_000_000, "'xxx"),
        (b"\x00" * 10_000_000, "b'\\x00"),
        (deep(10_000), "[[[["),
        (1 << 100_000, "0x1"),
        (-1 << 100_000, "-0x1"),
        ([1 << 100_000], "[0x1"),
    ],
    ids=range(9),  # pytest would show the values
)
def test_no_more_is_made_than_is_shown(value, begins):
    shown = bounded_repr(value, 40)
    assert shown.startswith(begins)
    assert len(shown) == 40
    assert shown.endswith("…")
    assert one_line(value, 30).startswith(begins.strip("'")[:5])
    assert len(one_line(value, 30)) == 30


def test_secrets_are_looked_for_however_deep():
    assert str(redact(deep(10_000))).count("[") == 100


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("", ""),
        ("no address? at all@home", "no address? at all@home"),
        ("http://127.0.0.1:8080/v1", "http://127.0.0.1:8080/v1"),
        ("https://host/v1?key=s3cret", "https://host/v1?***"),
        ("https://host?s3cret", "https://host?***"),
        ("https://host/v1#s3cret", "https://host/v1?***"),
        ("https://me:s3cret@host:8/v1", "https://host:8/v1"),
        ("https://me:s3@cret@host/p@th", "https://host/p@th"),
        ("get HTTP://s3cret@host/a?b=s3cret, then", "get HTTP://host/a?*** then"),
        ("http://a?s3cret http://s3cret@b", "http://a?*** http://b"),
        ("http://[host?s3cret", "http://[host?***"),
        ("tcp/127.0.0.1:7447", "tcp/127.0.0.1:7447"),
        ("tls/[::1]:7447?rel=1#key=s3cret;b=2", "tls/[::1]:7447?***"),
        ("at unixsock-stream//run/a.sock#s3cret, then", "at unixsock-stream//run/a.sock?*** then"),
        ("docs/security.md#certificates", "docs/security.md#certificates"),
        ({"password": "s3cret", "user": "me"}, {"password": "***", "user": "me"}),
        ({"Api_Key": ["s3cret"], "my_token": 7}, {"Api_Key": "***", "my_token": "***"}),
        ({"api_key_env": "NAME", "token": None}, {"api_key_env": "NAME", "token": None}),
        ({"a": [{"secret": "s3cret"}]}, {"a": [{"secret": "***"}]}),
        (None, None),
        ([1, True, {"a": ("http://x?y", 2.5)}], [1, True, {"a": ["http://x?***", 2.5]}]),
    ],
)
def test_secrets_in_urls_are_redacted(said, shown):
    assert redact(said) == shown
    assert redact(shown) == shown


NO_OBJECTS = [b"", b"\xff\x00", b"[" * 100_000, b"3", b'"x"', b"[1]", b'{"a": 1}']


@pytest.mark.parametrize("data", NO_OBJECTS)
def test_an_invalid_json_object_is_refused_in_one_line(data):
    says = r"^(not JSON|not a JSON object|8 bytes, at most 7 are accepted)$"
    with pytest.raises(ValueError, match=says):
        read_json_object(data, 100_000 if len(data) > 8 else 7)
