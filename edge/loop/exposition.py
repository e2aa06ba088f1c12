"""Metrics as a page for Prometheus: tables of what there is, read when the page is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

from prometheus_client import (
    CONTENT_TYPE_LATEST,
    CollectorRegistry,
    GCCollector,
    PlatformCollector,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    StateSetMetricFamily,
)
from prometheus_client.core import Metric as Family
from prometheus_client.registry import Collector

from edge.host.pages import Page
from edge.loop.histogram import Histogram
from edge.text import one_line

MOST_SERIES = 100
"""Of one counter. What is counted by names of others' making may come to any number of them, and
each would be kept by Prometheus for weeks: the rest is summed up as `OTHER`."""
OTHER = "other"
_LONGEST_LABEL = 100

Source = TypeVar("Source")
Kind = Literal["counter", "gauge", "state", "histogram"]

_FAMILIES = {
    "counter": CounterMetricFamily,
    "gauge": GaugeMetricFamily,
    "histogram": HistogramMetricFamily,
}


@dataclass(frozen=True, slots=True)
class Metric(Generic[Source]):
    """One line of a table.

    Attributes:
        name: in base units (seconds, bytes); a counter's ends in `_total`.
        help: what it is, for people.
        read: from the source: a number, or a `Histogram`; where there are labels, a mapping from
            a label's value, or a tuple of values, to that. A state's is its name. None: there is
            none now.
        labels: names.
        states: all that a `state` can be; it has a series for each, 1 for the present one.
    """

    name: str
    kind: Kind
    help: str
    read: Callable[[Source], Any]
    labels: tuple[str, ...] = ()
    states: tuple[str, ...] = ()


Read = Callable[[], Iterable[Family]]


def families(table: Iterable[Metric[Source]], source: Source) -> Iterator[Family]:
    """The metrics of a table as they stand in a source."""
    for metric in table:
        found = metric.read(source)
        if metric.kind == "state":
            yield StateSetMetricFamily(
                metric.name, metric.help, {state: state == found for state in metric.states}
            )
            continue
        found = {} if found is None else found
        samples = found if isinstance(found, Mapping) else {(): found}
        family = _FAMILIES[metric.kind](metric.name, metric.help, labels=metric.labels)
        (_fill_buckets if metric.kind == "histogram" else _fill)(family, samples)
        yield family


class Exposition(Collector):
    """What a scrape of the service gets: the process and its interpreter, and what `read` yields.

    Args:
        read: called at every scrape, on a thread of its own.
    """

    def __init__(self, read: Read) -> None:
        self._read = read
        self._registry = CollectorRegistry()
        self._registry.register(self)
        for collector in (ProcessCollector, GCCollector, PlatformCollector):
            collector(registry=self._registry)

    def collect(self) -> Iterable[Family]:
        return self._read()

    def page(self) -> Page:
        """In Prometheus' text format."""
        return Page(generate_latest(self._registry), CONTENT_TYPE_LATEST)


def _fill(family: Any, samples: Mapping[Any, float]) -> None:
    """Add a sample for each label, or tuple of labels; two that look alike are one."""
    merged: dict[tuple[str, ...], float] = {}
    for key, value in samples.items():
        labels = tuple(one_line(text, _LONGEST_LABEL) for text in _labels(key))
        if family.type == "counter":
            if labels not in merged and len(merged) >= MOST_SERIES:
                labels = (OTHER,) * len(labels)
            value += merged.get(labels, 0)
        merged[labels] = value
    for labels, value in merged.items():
        family.add_metric(labels, value)


def _fill_buckets(family: Any, samples: Mapping[Any, Histogram]) -> None:
    """Add the buckets of each label; in Prometheus' a bucket holds all that is shorter, too."""
    for key, histogram in samples.items():
        upto, buckets = 0, []
        bounds = (*map(repr, histogram.bounds_s), "+Inf")
        for bound, count in zip(bounds, histogram.counts, strict=True):
            upto += count
            buckets.append((bound, upto))
        family.add_metric(_labels(key), buckets, histogram.sum_s)


def _labels(key: str | tuple[str, ...]) -> tuple[str, ...]:
    return key if isinstance(key, tuple) else (key,)
