"""The report of an evaluation: all results as JSON, and tables in Markdown."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gapmes.service.mending.fade_passes import DEFAULT_PASSES
from gapmes.service.process.streams import visible

from .floors import Floor, floors
from .models import Model
from .scores import Group
from .tables import floor_table, group_section, precision_table, table


@dataclass(frozen=True)
class Report:
    """All groups of a run, and the evaluated models."""

    models: Sequence[Model]
    groups: Sequence[Group]
    lpips: str | None  # name of the weights file
    fade: int = DEFAULT_PASSES  # passes of fading in every reconstruction

    @property
    def floors(self) -> list[Floor]:
        return floors(self.groups)

    def document(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {
            "models": [_model_entry(model) for model in self.models],
            "lpips": self.lpips,
            "fade": self.fade,
            "groups": [_group_entry(group) for group in self.groups],
            "floors": [asdict(floor) for floor in self.floors],
        }

    def markdown(self) -> str:
        """Models and floors, then for every group: means, scenes, twice the size, routing."""
        lines = ["# Evaluation", "", *_models_section(self.models)]
        lines += [f"Passes of fading: {self.fade}.", ""]
        if self.lpips is None:
            lines += ["LPIPS is left out: there are no weights for it (`--lpips FILE`).", ""]
        lines += ["## Floors", "", *floor_table(self.floors), ""]
        if any(len(group.models) > 1 for group in self.groups):
            lines += ["## Difference between the models", "", *precision_table(self.groups, self.lpips is not None), ""]
        for group in self.groups:
            lines += group_section(group, self.lpips is not None)
        return "\n".join(map(visible, lines)).rstrip() + "\n"  # names of files may hold line ends

    def write(self, folder: Path) -> list[Path]:
        """Write report.json and report.md into `folder`, which is made if missing; returns their paths."""
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / "report.json", folder / "report.md"]
        paths[0].write_text(json.dumps(self.document(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        paths[1].write_text(self.markdown(), encoding="utf-8", errors="backslashreplace")  # names of files
        return paths


def _models_section(models: Sequence[Model]) -> list[str]:
    rows = [
        [
            m.label,
            m.file,
            m.engine.info.precision,
            _engine(m),
            f"{m.size.height} x {m.size.width}",
            m.engine.info.weights_sha256[:12],
        ]
        for m in models
    ]
    return [*table(["model", "file", "precision", "engine", "height x width, px", "weights"], rows), ""]


def _engine(model: Model) -> str:
    found = model.engine.made_by
    return f"{found.name} {found.version}, {found.precision}"


def _model_entry(model: Model) -> dict[str, Any]:
    info = model.engine.info
    return {
        "label": model.label,
        "file": model.file,
        "precision": info.precision,
        "height": info.height,
        "width": info.width,
        "engine": model.engine.made_by.document(),
        "weights_sha256": info.weights_sha256,
        "file_sha256": info.file_sha256,
    }


def _group_entry(group: Group) -> dict[str, Any]:
    """The scenes of a group with its means and margins."""
    scenes = [
        {**asdict(scene), "best_baseline": scene.best_baseline, "margin": {m: scene.margin(m) for m in group.models}}
        for scene in group.scenes
    ]
    means = {name: asdict(score) for name, score in group.methods().items()}
    margins = {}
    for model in group.models:
        best, margin = group.margin_of_means(model)
        values = group.margins(model)
        margins[model] = {
            "mean_above_best_of_each_scene": sum(values) / len(values),
            "best_on_average": best,
            "above_best_on_average": margin,
        }
    return {
        "title": group.title,
        "kind": group.kind,
        "inputs": group.inputs,
        "height": group.size.height,
        "width": group.size.width,
        "seed": group.seed,
        "whole": group.whole,
        "covisible_from": group.covisible_from,
        "left_out": dict(group.left_out),
        "mean": means,
        "margin": margins,
        "routing": {name: None if value is None else asdict(value) for name, value in group.routing.items()},
        "scenes": scenes,
    }
