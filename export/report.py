"""The verification report as data: one row per case, written as JSON beside the exported file."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from .compare import Deviation
from .deviations import Float64Comparison
from .pictures import PictureAgreement
from .routes import RouteAgreement


@dataclass(frozen=True)
class CaseResult:
    """The result of one case: errors of the outputs, agreement of routes, and failures, none if it passed."""

    name: str
    gates: str
    views: int
    outputs: dict[str, Deviation] = field(default_factory=dict)
    beside_float64: dict[str, Float64Comparison] = field(default_factory=dict)  # for outputs beyond a limit
    routes: RouteAgreement | None = None
    picture: PictureAgreement | None = None  # of the rendered results, where they were compared
    failures: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Report:
    """All cases of one file."""

    model_sha256: str
    precision: str
    versions: dict[str, str]
    cases: list[CaseResult]

    @property
    def passed(self) -> bool:
        return bool(self.cases) and not any(case.failures for case in self.cases)

    def worst(self) -> dict[str, dict[str, float]]:
        """Per output the largest maximum, p99, mean and share of jumps over all cases, for the file's metadata."""
        result: dict[str, dict[str, float]] = {}
        for case in self.cases:
            for name, value in case.outputs.items():
                entry = result.setdefault(name, {"max": 0.0, "p99": 0.0, "mean": 0.0, "jumps": 0.0})
                entry["max"] = max(entry["max"], value.maximum)
                entry["p99"] = max(entry["p99"], value.p99)
                entry["mean"] = max(entry["mean"], value.mean)
                entry["jumps"] = max(entry["jumps"], value.jumps)
        return result

    def to_json(self) -> str:
        """The report as JSON, with null for numbers that are not finite."""
        body = {"passed": self.passed, "worst": self.worst(), **asdict(self)}
        return json.dumps(_finite(body), indent=2, sort_keys=True, allow_nan=False) + "\n"

    def write(self, path: Path) -> None:
        path.write_text(self.to_json())

    @staticmethod
    def read(path: Path) -> Report:
        body = json.loads(path.read_text())
        cases = [
            CaseResult(
                name=case["name"],
                gates=case["gates"],
                views=case["views"],
                outputs={name: Deviation(**_read(value)) for name, value in case["outputs"].items()},
                beside_float64={
                    name: Float64Comparison(Deviation(**_read(value["exported"])), Deviation(**_read(value["torch"])))
                    for name, value in case.get("beside_float64", {}).items()
                },
                routes=RouteAgreement(**_read(case["routes"])) if case["routes"] else None,
                picture=PictureAgreement(**_read(case["picture"])) if case["picture"] else None,
                failures=case["failures"],
            )
            for case in body["cases"]
        ]
        return Report(body["model_sha256"], body["precision"], body["versions"], cases)


def _finite(value: Any) -> Any:
    """`value` with None for every number that is not finite."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _read(value: dict[str, Any]) -> dict[str, Any]:
    """Inverse of `_finite` for one object: infinity for None."""
    return {name: math.inf if number is None else number for name, number in value.items()}
