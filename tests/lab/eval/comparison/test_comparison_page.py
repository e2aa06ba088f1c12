"""The page: it shows every driven trail, fetches nothing and escapes any text."""

from __future__ import annotations

import base64
import hashlib
import re
from itertools import pairwise

import numpy as np
from html_reader import Reader
from made_outcomes import failure, many, record

from edge.lab.eval.comparison import page
from edge.lab.eval.comparison.outcomes import gather
from edge.lab.eval.comparison.statistics import compare
from edge.lab.eval.comparison.worlds import FloorPlanDrawing

BAD = '<script>alert("x")</script>&\'"'
BOX = np.array([[2.0, 2.0], [3.0, 2.0], [3.0, 3.0], [2.0, 3.0]])
DRAWING = FloorPlanDrawing(b"png", 0.0, 4.0, 5.0, 4.0, {"bed": [BOX]})


def page_of(records, drawings=None) -> str:
    comparison = compare(gather(records), resamples=50)
    return page.html(comparison, drawings or {}, "Trial", "a machine")


def points(path: str) -> list[tuple[int, int]]:
    start, _, steps = path.removeprefix("M").partition("l")
    x, y = map(int, start.split())
    found, numbers = [(x, y)], list(map(int, re.findall(r"-?\d+", steps)))
    for dx, dy in zip(numbers[::2], numbers[1::2], strict=True):
        found.append((found[-1][0] + dx, found[-1][1] + dy))
    return found


def test_nothing():
    reader = Reader(page_of([]))
    assert "0 episodes in 0 worlds" in reader.text
    assert reader.all("article") == []


def test_a_trail_is_drawn_along_the_driven_path():
    trail = [[1.0, 1.0], [1.25, 1.0], [1.5, 1.0], [1.5, 1.0], [1.5, 0.75], [1.25, 0.75]]
    goals = [[2.0, 1.0, "frontier"], [2.5, 2.0, "instance"], [0.0, 4.0, "spin"]]
    one = record(world="w", trail=trail, first_sight_path_m=0.5, goal_xy=goals)
    reader = Reader(page_of([one], {"w": DRAWING}))
    pieces = [points(a["d"]) for a in reader.all("path", "t")]
    driven = pieces[0] + [p for piece in pieces[1:] for p in piece[1:]]
    # 5 cm a unit, y downwards from 4 m; a standing robot adds one point.
    assert driven == [(20, 60), (25, 60), (30, 60), (30, 65), (25, 65)]
    assert all(a[-1] == b[0] for a, b in pairwise(pieces))
    assert [a["d"] for a in reader.all("path", "g")][-3:] == ["M40 60h0", "M50 40h0", "M0 0h0"]
    seen, start, end = (reader.all("circle", kind)[-1] for kind in ("seen", "start", "end"))
    assert [(int(c["cx"]), int(c["cy"])) for c in (seen, start, end)] == [
        (30, 60),
        (20, 60),
        (25, 65),
    ]


def test_nothing_is_fetched_and_no_script_but_ours_runs():
    text = page_of(many({"a": 1.5, "b": 2.5}, 2), {"house-0": DRAWING})
    reader = Reader(text)
    sources = [a[key] for _, a in reader.tags for key in ("src", "href") if key in a]
    assert sources
    assert all(s.startswith(("data:image/", "#")) for s in sources)
    assert not re.search(r"https?:|url\(|@import|fetch|XMLHttp", text)
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.S)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    (policy,) = [a["content"] for a in reader.all("meta") if "http-equiv" in a]
    assert f"script-src 'sha256-{digest}'" in policy
    assert "default-src 'none'" in policy


def test_text_cannot_become_markup():
    bad = record(BAD, BAD, world=BAD, target=BAD, reason=BAD, instruction=BAD)
    text = page_of([bad, failure("2", "b", target=None, instruction=BAD)])
    reader = Reader(text)
    assert len(reader.all("script")) == 1
    assert reader.text.count("alert(") >= 6


def test_articles_carry_the_values_for_sorting_and_filtering():
    records = [record("1", "a"), failure("1", "b"), record("2", "b", path_m=5.0)]
    first, second = Reader(page_of(records)).all("article")
    assert (first["data-spl"], first["data-path"], first["data-shortest"]) == (
        "0.5,0",
        "10,40",
        "5.00",
    )
    assert first["data-kinds"] == "|never seen"
    assert (second["data-spl"], second["data-path"]) == (",1", ",5")
