"""Metrics in the text format of Prometheus."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from rce.errors import InvalidRequest
from rce.process.metrics import Family, Sample

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_NAME = re.compile(r"[a-zA-Z_][a-zA-Z0-9_]*", re.ASCII)


class _FamilyCollector(Collector):
    """Collector of families that were collected before."""

    def __init__(self, families: Iterable[Family]) -> None:
        self._families = families

    def collect(self) -> Iterator[Metric]:
        return map(_metric, self._families)


def prometheus_text(families: Iterable[Family]) -> bytes:
    """Format families, which may come from another process, as text for Prometheus.

    Raises:
        InvalidRequest: A family is not a valid metric.
    """
    registry = CollectorRegistry(auto_describe=False)
    try:
        registry.register(_FamilyCollector(families))
        return generate_latest(registry)
    except (ValueError, IndexError) as error:
        raise InvalidRequest(f"the process reported invalid metrics: {error}") from None


def _metric(family: Family) -> Metric:
    for name in (family.name, *family.labels):
        if not _NAME.fullmatch(name):
            raise ValueError(f"{name[:80]!r} is not a valid name of a metric or label")
    if any(len(sample.labels) != len(family.labels) for sample in family.samples):
        raise ValueError(f"{family.name} has samples that do not match its labels")
    if family.kind == "histogram":
        histogram = HistogramMetricFamily(family.name, family.help, labels=family.labels)
        for sample in family.samples:
            histogram.add_metric(sample.labels, list(_buckets(family, sample)), sample.value)
        return histogram
    kind = CounterMetricFamily if family.kind == "counter" else GaugeMetricFamily
    metric = kind(family.name, family.help, labels=family.labels)
    for sample in family.samples:
        metric.add_metric(sample.labels, sample.value)
    return metric


def _buckets(family: Family, sample: Sample) -> Iterator[tuple[str, float]]:
    """Yield the cumulative count for each upper bound, as Prometheus wants it."""
    total = 0
    for bound, count in zip([*map(str, family.bounds), "+Inf"], sample.counts, strict=True):
        total += count
        yield bound, total
