"""What the service counts and times; processes that share a port write where one of them can add them up."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, disable_created_metrics

from .document import gaussians_left_out
from .process.peers import FOLDER, is_alive
from .progress import Stage

SHARED = FOLDER in os.environ
BUCKETS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0)

disable_created_metrics()
OWN = CollectorRegistry()
REQUESTS = Counter("gapmes_requests", "Answers", ["method", "route", "status"], registry=OWN)
SECONDS = Histogram("gapmes_request_seconds", "Time to the last byte", ["route"], registry=OWN, buckets=BUCKETS)
REJECTED = Counter("gapmes_rejected", "Refusals", ["code"], registry=OWN)
STAGES = Histogram("gapmes_stage_seconds", "Stages of jobs and pictures", ["stage"], registry=OWN, buckets=BUCKETS)
JOBS = Counter("gapmes_jobs", "Jobs that ended", ["state"], registry=OWN)
PLACES = Gauge(
    "gapmes_places_taken",
    "Requests that hold a place or wait for their turn",
    ["of"],
    registry=OWN,
    multiprocess_mode="livesum",
)
GAUSSIANS = Counter("gapmes_gaussians", "Gaussians of reconstructions", ["fate"], registry=OWN)
if not SHARED:
    ProcessCollector(registry=OWN)


def stage_ended(stage: Stage) -> None:
    """Time a stage of a job."""
    if stage.seconds is not None:
        STAGES.labels(stage.name).observe(stage.seconds)


def reconstructed(document: Mapping[str, Any]) -> None:
    """Count what a scene kept and left out."""
    GAUSSIANS.labels("kept").inc(document["pruning"]["kept"])
    GAUSSIANS.labels("dropped").inc(gaussians_left_out(document))


def forget_dead(folder: Path) -> None:
    """Remove the gauges that processes left in `folder` which are gone."""
    for file in folder.glob("gauge_live*.db"):
        if not is_alive(int(file.stem.rpartition("_")[2])):
            file.unlink(missing_ok=True)
