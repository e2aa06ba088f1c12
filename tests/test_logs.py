"""Log lines for people and for machines."""

from __future__ import annotations

import io
import json
import logging

import pytest

from edge import logs


def test_human_lines():
    out = io.StringIO()
    logs.setup("info", stream=out)
    log = logging.getLogger("edge.mapping")
    log.debug("hidden")
    log.warning("%d cells", 3)
    logging.getLogger("matplotlib.font_manager").info("noise")
    (line,) = out.getvalue().splitlines()
    assert line.endswith("warning mapping: 3 cells")


def test_json_lines():
    out = io.StringIO()
    logs.setup("debug", as_json=True, stream=out)
    log = logging.getLogger("edge.loop.service")
    log.debug("a\nb", extra={"stage": "map", "odd": {1}})
    try:
        raise ValueError("bad")
    except ValueError:
        log.exception("failed")
    first, second = map(json.loads, out.getvalue().splitlines())
    assert (first["level"], first["logger"], first["message"]) == (
        "debug",
        "edge.loop.service",
        "a\nb",
    )
    assert (first["stage"], first["odd"]) == ("map", "{1}")
    assert "ValueError: bad" in second["exception"]


SAID = (
    "goal failed: stuck\n12:00:00.000 info    mission: \x1b[31mreached\x9b2J\u202e" + "!" * 10_000
)


@pytest.mark.parametrize("as_json", [False, True])
def test_quoted_text_forges_no_line_and_no_escape_code(as_json):
    out = io.StringIO()
    logs.setup("info", as_json, stream=out)
    logging.getLogger("edge.loop.goals.goal").warning("%s", SAID)
    line = out.getvalue().removesuffix("\n")
    assert line.isprintable()
    if as_json:
        assert json.loads(line)["message"] == SAID
    else:
        assert "goal failed: stuck 12:00:00.000 info mission: [31mreached 2J !!" in line
        assert len(line) < logs.MAX_MESSAGE + 100


def test_a_traceback_is_indented_without_control_characters():
    out = io.StringIO()
    logs.setup("info", stream=out)
    try:
        raise ValueError("bad\n12:00:00.000 info    mission: \x1b[31mreached")
    except ValueError:
        logging.getLogger("edge").exception("failed: %s", "a\nb")
    first, *trace = out.getvalue().splitlines()
    assert first.endswith("error   edge: failed: a b")
    assert trace[0] == "    Traceback (most recent call last):"
    assert all(line.startswith("    ") and line.isprintable() for line in trace)
    assert trace[-1] == "    12:00:00.000 info    mission:  [31mreached"


@pytest.mark.parametrize("as_json", [False, True])
def test_invalid_unicode_is_logged(as_json):
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    logs.setup("info", as_json, stream=out)
    logging.getLogger("edge").warning("file \udc80 and 🪑")
    out.flush()
    assert "🪑" in out.buffer.getvalue().decode()


def test_unknown_level():
    with pytest.raises(ValueError, match="choices: debug"):
        logs.setup("loud")


def test_once(monkeypatch):
    monkeypatch.setattr(logs, "_seen", {})
    assert [logs.first_time(key) for key in ("a", "b", "a", ("a", 1), ("a", 1))] == [
        True, True, False, True, False,
    ]  # fmt: skip
