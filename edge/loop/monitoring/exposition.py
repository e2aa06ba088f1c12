"""Prometheus page of metrics. Tables list the metrics; a scrape reads their values.

`metrics` has the tables. A metric has one series for each combination of label values.
"""

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
    Metric,
    StateSetMetricFamily,
)
from prometheus_client.registry import Collector

from edge.host.web_server import HttpResponse
from edge.loop.histogram import Histogram
from edge.text import one_line

MOST_SERIES = 100
"""Largest number of series of one counter. Labels from outside may have any number of values, and
Prometheus keeps each series for weeks. All further values share one series, `OTHER`."""
OTHER = "other"
_LONGEST_LABEL = 100  # characters of a label value

Source = TypeVar("Source")
Kind = Literal["counter", "gauge", "state", "histogram"]
"""Kinds of Prometheus; a `state` is a StateSet: one series for each state."""

_CLASSES = {
    "counter": CounterMetricFamily,
    "gauge": GaugeMetricFamily,
    "histogram": HistogramMetricFamily,
}


@dataclass(frozen=True, slots=True)
class MetricSpec(Generic[Source]):
    """The definition of one metric.

    Attributes:
        name: Name in base units (seconds, bytes). The name of a counter ends in `_total`.
        help: Description for people.
        read: Returns the value from the source: a number, a `Histogram`, or the name of a state.
            With labels: a mapping from a label value, or a tuple of values, to numbers or
            histograms. None: there is no value now.
        states: All values of a `state`. Each has a series, which is 1 for the current state.
    """

    name: str
    kind: Kind
    help: str
    read: Callable[[Source], Any]
    labels: tuple[str, ...] = ()
    states: tuple[str, ...] = ()


ReadMetrics = Callable[[], Iterable[Metric]]
"""Function that returns all metrics with their current values; called at each scrape."""


def read_table(table: Iterable[MetricSpec[Source]], source: Source) -> Iterator[Metric]:
    """Yield the metrics of a table with their current values in a source."""
    for spec in table:
        found = spec.read(source)
        if spec.kind == "state":
            yield StateSetMetricFamily(
                spec.name, spec.help, {state: state == found for state in spec.states}
            )
            continue
        found = {} if found is None else found
        # A metric without labels has one series, with the empty tuple of label values.
        samples = found if isinstance(found, Mapping) else {(): found}
        metric = _CLASSES[spec.kind](spec.name, spec.help, labels=spec.labels)
        if spec.kind == "histogram":
            _add_histograms(metric, samples)
        else:
            _add_numbers(metric, samples)
        yield metric


class Exposition(Collector):
    """The page `/metrics`: metrics of the process and the interpreter, and those of `read`."""

    def __init__(self, read: ReadMetrics) -> None:
        self._read = read
        self._registry = CollectorRegistry()
        self._registry.register(self)
        for collector in (ProcessCollector, GCCollector, PlatformCollector):
            collector(registry=self._registry)

    def collect(self) -> Iterable[Metric]:
        """Return the metrics of `read`; the registry calls it at each scrape."""
        return self._read()

    def page(self) -> HttpResponse:
        """Return the page in the text format of Prometheus."""
        return HttpResponse(generate_latest(self._registry), CONTENT_TYPE_LATEST)


def _add_numbers(metric: Any, samples: Mapping[Any, float]) -> None:
    """Add a sample for each label value, or tuple of label values.

    Label values may become equal when `one_line` cuts them. Counters of equal labels are then
    added. Of gauges, the last one wins.
    """
    merged: dict[tuple[str, ...], float] = {}
    for key, value in samples.items():
        labels = tuple(one_line(text, _LONGEST_LABEL) for text in _labels(key))
        if metric.type == "counter":
            if labels not in merged and len(merged) >= MOST_SERIES:
                labels = (OTHER,) * len(labels)
            value += merged.get(labels, 0)
        merged[labels] = value
    for labels, value in merged.items():
        metric.add_metric(labels, value)


def _add_histograms(metric: Any, samples: Mapping[Any, Histogram]) -> None:
    """Add the buckets for each label value. Buckets of Prometheus are cumulative."""
    for key, histogram in samples.items():
        n_samples, buckets = 0, []
        bounds = (*map(repr, histogram.bounds_s), "+Inf")
        for bound, count in zip(bounds, histogram.counts, strict=True):
            n_samples += count
            buckets.append((bound, n_samples))
        metric.add_metric(_labels(key), buckets, histogram.sum_s)


def _labels(key: str | tuple[str, ...]) -> tuple[str, ...]:
    return key if isinstance(key, tuple) else (key,)
