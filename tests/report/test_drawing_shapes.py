"""Shapes as SVG and PNG: well-formed, escaped, and the same picture."""

from __future__ import annotations

from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from edge.report.drawing.shapes import (
    Box,
    Curve,
    Disc,
    Group,
    Picture,
    Polygon,
    Text,
    paragraph,
    png,
    shorten,
    svg,
    text_width,
)

BAD = "<script>alert('x')</script>&\"$x^"
RED = "#ff0000"


def picture(*shapes) -> Picture:
    return Picture(BAD, 100.0, 60.0, (Group(BAD, shapes),))


def pixels(content: bytes) -> np.ndarray:
    bgr = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


def test_an_empty_picture_is_white():
    empty = Picture("", 100.0, 60.0, ())
    assert ElementTree.fromstring(svg(empty)).get("viewBox") == "0 0 100 60"
    image = pixels(png(empty))
    assert image.shape == (120, 200, 3)
    assert image.min() == 255


@pytest.mark.parametrize(
    ("shape", "inside", "outside"),
    [
        (Box(10, 10, 40, 20, RED), (20, 30), (20, 70)),
        (Disc(50, 30, 12, RED, RED), (30, 50), (30, 70)),
        (Polygon(((10, 10), (40, 10), (40, 40)), RED), (20, 35), (35, 15)),
        (Curve(((0, 30), (30, 30), (60, 30), (90, 30)), RED, 6.0), (30, 45), (45, 45)),
    ],
)
def test_each_shape_is_where_it_should_be(shape, inside, outside):
    image = pixels(png(picture(shape)))
    assert image[2 * inside[0], 2 * inside[1]].tolist() == [255, 0, 0]
    assert image[2 * outside[0], 2 * outside[1]].tolist() == [255, 255, 255]
    assert RED in svg(picture(shape))


@pytest.mark.parametrize(
    ("anchor", "low", "high"), [("start", 49, 99), ("middle", 20, 80), ("end", 0, 52)]
)
def test_text_stands_by_its_anchor(anchor, low, high):
    image = pixels(png(picture(Text("word", 50, 30, 12, RED, anchor, bold=True))))
    columns = np.flatnonzero((image != 255).any(axis=(0, 2))) / 2
    assert low <= columns.min() < columns.max() <= high
    rows = np.flatnonzero((image != 255).any(axis=(1, 2))) / 2
    assert 15 < rows.min() < rows.max() <= 31


def test_any_text_is_text():
    drawn = picture(Text(BAD, 5, 30, 8, RED))
    root = ElementTree.fromstring(svg(drawn))
    tags = {element.tag.rpartition("}")[2] for element in root.iter()}
    assert tags == {"svg", "title", "rect", "g", "text"}
    assert [e.text for e in root.iter() if e.text] == [BAD, BAD, BAD]
    assert png(drawn).startswith(b"\x89PNG")


def test_words():
    assert text_width("", 10) == 0
    assert text_width("沙发", 10) > text_width("so", 10)
    assert shorten("ab\ncd\x00", 10) == "ab�cd�"
    assert shorten("x" * 200, 10) == "x" * 9 + "…"
    assert paragraph("", 10, 50) == ("",)
    lines = paragraph("one two three four " + "long" * 30, 10, 60)
    assert " ".join(lines) == "one two three four " + "long" * 30
    assert all(text_width(line, 10) <= 60 for line in lines[:-1])
