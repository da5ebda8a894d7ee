"""`GET /metrics` for Prometheus, summed over the processes that share a port."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from fastapi import APIRouter, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.metrics_core import GaugeMetricFamily, Metric
from prometheus_client.multiprocess import MultiProcessCollector
from prometheus_client.registry import Collector

from ..metrics import OWN, SHARED, forget_dead
from ..process.peers import FOLDER
from .runtime import RuntimeDep

if TYPE_CHECKING:
    from ..jobs.table import JobTable
    from ..scenes.store import SceneStore

router = APIRouter(tags=["operations"])


class _Now(Collector):
    """Current numbers of jobs and scenes, from the store's database."""

    def __init__(self, store: SceneStore, table: JobTable) -> None:
        self._store, self._table = store, table

    def collect(self) -> Iterator[Metric]:
        active = GaugeMetricFamily("gapmes_jobs_active", "Jobs that are queued or running", labels=["state"])
        for state, count in self._table.counts().items():
            active.add_metric([state], count)
        yield active
        count, size = self._store.totals()
        yield GaugeMetricFamily("gapmes_scenes", "Scenes in the store", value=count)
        yield GaugeMetricFamily("gapmes_scenes_bytes", "Their size", value=size)


@router.head("/metrics", include_in_schema=False)
@router.get("/metrics", response_class=Response, responses={200: {"content": {CONTENT_TYPE_LATEST: {}}}})
def metrics(runtime: RuntimeDep) -> Response:
    """Metrics in the text format of Prometheus."""
    registry = CollectorRegistry()
    if SHARED:
        runtime.peers.keep()
        forget_dead(Path(os.environ[FOLDER]))
        MultiProcessCollector(registry)
    own = b"" if SHARED else generate_latest(OWN)
    registry.register(_Now(runtime.store, runtime.jobs.table))
    return Response(own + generate_latest(registry), media_type=CONTENT_TYPE_LATEST)
