"""Tables of metrics as Prometheus reads them, whatever their labels hold."""

from __future__ import annotations

import pytest
from prometheus_client.parser import text_string_to_metric_families

from edge.loop.histogram import Histogram
from edge.loop.monitoring.exposition import MOST_SERIES, OTHER, Exposition, MetricSpec, read_table

NASTY = ['say "hi"', "a\nb", "\\", "x" * 10_000, "\0\x1b[2J", "ß→", "", "a b\r\nc"]


def read(*table: MetricSpec) -> dict[str, dict[tuple[str, ...], float]]:
    """Name of a sample → its labels' values → value, as Prometheus' own parser reads the page."""
    page = Exposition(lambda: read_table(table, None)).page()
    assert page.media_type.startswith("text/plain")
    found: dict[str, dict[tuple[str, ...], float]] = {}
    for family in text_string_to_metric_families(page.body.decode()):
        for sample in family.samples:
            series = found.setdefault(sample.name, {})
            assert tuple(sample.labels.values()) not in series
            series[tuple(sample.labels.values())] = sample.value
    return found


@pytest.mark.parametrize(
    ("metric", "samples"),
    [
        (MetricSpec("a_total", "counter", "h", lambda _: 3), {"a_total": {(): 3}}),
        (MetricSpec("a", "gauge", "h", lambda _: True), {"a": {(): 1}}),
        (MetricSpec("a", "gauge", "h", lambda _: None), {}),
        (MetricSpec("a", "gauge", "h", lambda _: {}, ("x",)), {}),
        (MetricSpec("a", "gauge", "h", lambda _: {"p": 1, "q": 2}, ("x",)),
         {"a": {("p",): 1, ("q",): 2}}),
        (MetricSpec("a", "gauge", "h", lambda _: {("p", "q"): 1}, ("x", "y")), {"a": {("p",
        "q"): 1}}),
        (MetricSpec("a", "state", "h", lambda _: "on", states=("on", "off")),
         {"a": {("on",): 1, ("off",): 0}}),
        (MetricSpec("a_seconds", "histogram", "h", lambda _: Histogram((0.1, 1.0), (2, 0, 1), 3.5)),
         {"a_seconds_bucket": {("0.1",): 2, ("1.0",): 2, ("+Inf",): 3},
          "a_seconds_count": {(): 3}, "a_seconds_sum": {(): 3.5}}),
    ],
)  # fmt: skip
def test_every_kind(metric, samples):
    found = read(metric)
    assert {name: found[name] for name in found if name.startswith("a")} == samples


@pytest.mark.parametrize("text", NASTY)
def test_a_label_is_one_short_line(text):
    found = read(
        MetricSpec("a_total", "counter", "h", lambda _: {text: 1}, ("x",)),
        MetricSpec("b", "gauge", "h", lambda _: 2),
    )
    ((label,),) = found["a_total"]
    assert len(label) <= 100
    assert label.isprintable()
    assert found["b"] == {(): 2}


def test_endless_labels_of_a_counter_are_summed_up():
    counts = {f"reason {i}": 1 for i in range(10_000)}
    found = read(MetricSpec("a_total", "counter", "h", lambda _: counts, ("x",)))["a_total"]
    assert len(found) == MOST_SERIES + 1
    assert sum(found.values()) == 10_000
    assert found["reason 0",] == 1
    assert found[OTHER,] == 10_000 - MOST_SERIES


def test_a_read_error_fails_only_its_own_scrape():
    answers = iter([ValueError("no"), 1.0])

    def look(_: None) -> float:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    exposition = Exposition(lambda: read_table([MetricSpec("a", "gauge", "h", look)], None))
    with pytest.raises(ValueError, match="no"):
        exposition.page()
    assert b"\na 1.0\n" in exposition.page().body
