"""From a checkpoint to a verified file: export, quantise on request, verify in a separate process, accept or reject."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

import onnx

from gapmes.model.allocation import lacks_memory
from gapmes.model.architectures import licence
from gapmes.model.pretrained.fit import Fit
from gapmes.model.weights_file import file_sha256
from gapmes.service.errors import InputError
from gapmes.service.process.disk import named, replacing
from gapmes.service.process.ending import unfinished
from gapmes.service.process.output_file import check_output_file, check_output_folder
from gapmes.service.progress import Listener, Stage, Stages, silent

from . import memory
from .build import export_graph
from .metadata import add_metadata, contract_metadata
from .model_file import remove_model, write_model
from .quantise import quantised
from .report import Report
from .tolerance import Precision
from .variant import Variant, load_variant
from .verify import FAILED

AS_TRAINED = Variant()
ENDING = ".onnx"
REJECTED = ".rejected"  # before it


class VerificationBroken(Exception):
    """The verification process ended without a verdict."""


class ExportRejected(Exception):
    """The file is beyond tolerance; it is kept under another name, with its report."""

    def __init__(self, rejected: Path, report_path: Path, report: Report) -> None:
        self.rejected, self.report_path, self.report = rejected, report_path, report
        self.failures = [
            f"{case.name} ({case.gates}, {case.views} views): {failure}"
            for case in report.cases
            for failure in case.failures
        ]
        checks = "check" if len(self.failures) == 1 else "checks"
        cure = "; 8 bits may be too few for these weights: take --precision fp32" if report.precision == "int8" else ""
        super().__init__(f"{len(self.failures)} {checks} failed, first: {self.failures[0]}{cure}")


@dataclass(frozen=True)
class Exported:
    """The files of an accepted export."""

    model: Path
    report_path: Path
    report: Report
    fit: Fit | None  # how every tensor of a foreign checkpoint was used
    fit_path: Path | None  # the same as a file
    timings: dict[str, float]


def export_checkpoint(
    checkpoint: Path,
    out: Path,
    *,
    height: int,
    width: int,
    precision: Precision = "fp32",
    variant: Variant = AS_TRAINED,
    quick: bool = False,
    listener: Listener = silent,
) -> Exported:
    """Export, verify and write `out` with its report (`NAME.report.json`) and, for a foreign checkpoint, how each of
    its tensors was used (`NAME.checkpoint.json`). A symbolic link is followed: its target is replaced, and the other
    files are written beside the target.

    Raises `ExportRejected` when a check fails: the file is then kept as `NAME.rejected.onnx` with its report, and `out`
    is not changed. Raises `InputError`, before any work, where `out` or its report cannot be written, where `out` is
    the checkpoint or has the name of a rejected file, where a `NAME.checkpoint.json` is there that belongs to no
    earlier export, and for another ending than .onnx; `CheckpointError` and `ValueError` for a wrong checkpoint or
    size; `OutOfMemory`; `VerificationBroken` when there is no verdict. The last, like an interrupt, leaves no files.
    """
    _check_place(out, checkpoint)
    if out.suffix != ENDING:
        message = f"{out} ends in {out.suffix!r}, need {ENDING!r}, which tells networks from weights"
        raise InputError(message, field="out", cure=f"name it {out.name}{ENDING}")
    if out.is_symlink():
        out = out.resolve()
        _check_place(out, checkpoint)
    with memory.enough_memory(f"export for {height}x{width} px"):
        stages = Stages(listener)
        with stages.stage("load checkpoint"):
            loaded = load_variant(checkpoint, variant)
            network = loaded.network
        with stages.stage("export graph"):
            model = export_graph(network, height, width)
        if precision == "int8":
            with stages.stage("quantise"):
                model = quantised(model)
        metadata = contract_metadata(
            network,
            height=height,
            width=width,
            weights_sha256=file_sha256(checkpoint),
            licence=licence(checkpoint, variant.architecture),
            precision=precision,
        )
        add_metadata(model, metadata | ({"keep_all": "true"} if variant.keep_all else {}))
        with stages.stage("verify"):
            report = _verified(
                model, out, checkpoint, quick, lambda done, total: listener(Stage("verify", done, total))
            )
        rejected = _rejected_path(out)
        if not report.passed:
            raise ExportRejected(rejected, *_kept(model, rejected, report))
        exported = _accept(model, out, report, loaded.fit, stages.timings)
        remove_model(rejected)  # of an export before, with its report
        _report_path(rejected).unlink(missing_ok=True)
        return exported


def _check_place(out: Path, checkpoint: Path) -> None:
    """Raises `InputError` where `out` or a file beside it cannot be written, or would take the place of one that is not
    an export's; missing folders are no error."""
    check_output_folder(out.parent, field="out")
    if out.is_dir():
        check_output_file(out, field="out")
    if out.stem.endswith(REJECTED):
        raise InputError(f"{out} has the name of a rejected file", field="out", cure="name another file")
    if _fit_path(out).is_file() and not out.is_symlink() and not _exported(out):
        message = (
            f"{_fit_path(out)} is there, which tells of a checkpoint, and no exported file that it could belong to"
        )
        raise InputError(message, field="out", cure="name another file, or move that one")
    rejected = _rejected_path(out)
    for path in (out, _report_path(out), rejected, _report_path(rejected), _fit_path(out)):
        if out.parent.is_dir():
            check_output_file(path, field="out")
        if path.exists() and not path.is_file():
            raise InputError(f"{path} is a pipe or device, need a file", field="out", cure="name another file")
        if path.exists() and checkpoint.exists() and path.samefile(checkpoint):
            message = f"{path} would take the place of the checkpoint that it is made from"
            raise InputError(message, field="out", cure="name another file")


def _verified(
    model: onnx.ModelProto, out: Path, checkpoint: Path, quick: bool, on_case: Callable[[int, int], None]
) -> Report:
    """Verify the model as a file in a temporary folder, which is always removed."""
    out.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{out.stem}-", dir=out.parent) as folder, unfinished(Path(folder)):
        candidate = Path(folder) / out.name
        with named(out):
            write_model(model, candidate)
        return _verify_elsewhere(candidate, checkpoint, _report_path(candidate), quick, on_case)


def _kept(model: onnx.ModelProto, path: Path, report: Report) -> tuple[Path, Report]:
    """Write the model and its report under their final names. The report gets the sha256 of the final file, which names
    its external weights otherwise than the verified one; before that it is written once as it is, so that no model
    comes into place for whose report there is no room."""
    report_path = _report_path(path)
    with named(report_path), replacing(report_path) as part:
        report.write(part)
        with named(path):
            write_model(model, path)
        report = Report(file_sha256(path), report.precision, report.versions, report.cases)
        report.write(part)
    return report_path, report


def _rejected_path(out: Path) -> Path:
    return out.with_name(f"{out.stem}{REJECTED}{ENDING}")


def _fit_path(out: Path) -> Path:
    return out.with_name(f"{out.stem}.checkpoint.json")


def _report_path(model: Path) -> Path:
    return model.with_name(f"{model.stem}.report.json")


def _exported(out: Path) -> bool:
    """Whether an export was there before, to which what lies beside it belongs."""
    return out.exists() and _report_path(out).exists()


def _accept(model: onnx.ModelProto, out: Path, report: Report, fit: Fit | None, timings: dict[str, float]) -> Exported:
    add_metadata(model, {"tolerance": json.dumps(report.worst(), sort_keys=True)})
    fit_path = _fit_path(out)
    if fit is None:
        before = _exported(out)
        report_path, report = _kept(model, out, report)
        if before:
            fit_path.unlink(missing_ok=True)  # of the file that was here before
        return Exported(out, report_path, report, None, None, timings)
    with named(fit_path), replacing(fit_path) as part:
        fit.write(part)
        report_path, report = _kept(model, out, report)
    return Exported(out, report_path, report, fit, fit_path, timings)


def _verify_elsewhere(
    model: Path, checkpoint: Path, report: Path, quick: bool, on_case: Callable[[int, int], None]
) -> Report:
    # With -P modules of the working folder, such as an onnx.py, do not take the place of installed ones.
    isolated = [] if {"", os.getcwd()} & set(sys.path) else ["-P"]
    command = [sys.executable, *isolated, "-m", "gapmes.export.verify", f"--checkpoint={checkpoint}"]
    command += [f"--report={report}", f"--parent={os.getpid()}", *(["--quick"] if quick else []), "--", str(model)]
    # stderr goes to a file: a pipe that is not read would block the process when full
    with (
        TemporaryFile("w+") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        try:
            for done, line in enumerate(process.stdout or (), start=1):
                on_case(done, json.loads(line)["total"])
            code = process.wait()
        except BaseException:
            process.kill()  # it need not have received the interrupt
            raise
        if code not in (0, FAILED):
            errors.seek(0)
            raise VerificationBroken(_no_verdict(code, errors.read()))
    return Report.read(report)


def _no_verdict(code: int, told: str) -> str:
    """Why the verification process ended without a verdict: the last line of a traceback, or the signal."""
    if code < 0:
        cure = f"; lack of memory may be why: {memory.CURE}, or --quick" if code == -signal.SIGKILL else ""
        name = next((known.name for known in signal.Signals if known == -code), f"signal {-code}")
        return f"the verification process was ended by {name}{cure}"
    last = next((line.strip() for line in reversed(told.splitlines()) if line.strip()), "it does not say why")
    cure = f"; {memory.CURE}" if lacks_memory(last) else ""
    return f"the verification process ended with {code}: {last}{cure}"
