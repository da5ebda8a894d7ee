"""`gapmes evaluate`: quality on held-out views beside baselines, in one command."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from gapmes.service.commands.given import Threads, output_option
from gapmes.service.errors import GapmesError, ModelError
from gapmes.service.mending.fade_passes import DEFAULT_PASSES, checked_passes
from gapmes.service.network.backends.choice import DEFAULT_ENGINE, ENGINES
from gapmes.service.process.streams import write_result
from gapmes.service.process.terminal import ProgressBars, Quiet

NEEDED = ("torch", "onnx", "onnxscript", "safetensors")  # of the extra `export`
FLOOR_MISSED = 1


def evaluate(
    scenes: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SCENE_DIR...",
            readable=False,
            help="captures: any that reconstruct takes; cameras.json may name the views (`suggested`)",
        ),
    ] = None,
    generated: Annotated[int | None, typer.Option(min=0, help="number of generated scenes")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="seed of the generated scenes [default: that of the published figures]")
    ] = None,
    inputs: Annotated[list[int] | None, typer.Option(min=2, max=3, help="input views, 2 or 3; repeat for both")] = None,
    size: Annotated[list[str] | None, typer.Option(help="side in px, or HEIGHTxWIDTH; repeat for several")] = None,
    model: Annotated[
        list[Path] | None,
        typer.Option(readable=False, help=".onnx or .safetensors; repeat to compare [default: the packaged one]"),
    ] = None,
    engine: Annotated[
        list[str] | None, typer.Option(help=f"{', '.join(ENGINES)}; repeat to compare [default: {DEFAULT_ENGINE}]")
    ] = None,
    whole: Annotated[
        bool,
        typer.Option("--whole", help="photographs as a whole, as in reconstruct, not cropped to the size's aspect"),
    ] = False,
    twice: Annotated[bool, typer.Option("--twice", help="also draw at twice the size, and compare")] = False,
    fade: Annotated[int, typer.Option(help="passes of fading, as in reconstruct; 0: none")] = DEFAULT_PASSES,
    out: Annotated[Path, output_option("folder of the report", "-o", "--out")] = Path("evaluation"),
    lpips: Annotated[
        Path | None, typer.Option(readable=False, help="LPIPS weights, .safetensors [default: beside the checkout]")
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="exit with code 1 if a floor is missed")] = False,
    threads: Threads = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the report to stdout as JSON")] = False,
    quiet: Quiet = False,
) -> None:
    """Measure PSNR, SSIM and LPIPS on held-out views, beside baselines that learn nothing.

    Without SCENE_DIR and --generated it measures the scenes in a folder shared/scenes beside the checkout, if there is
    one, at 256 and 128 px from two and three views, and generated scenes, 24 at 256 and 100 at 128 px.
    """
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise GapmesError(f"evaluate needs {', '.join(missing)}", cure="pip install 'gapmes[export]'")

    import torch

    from gapmes.model.training.lpips import default_weights
    from gapmes.model.weights_file import CheckpointError

    from ..memory import OutOfMemory, enough_memory
    from ..size import Size
    from .models import checked_engines
    from .plans import evaluation_plans, outlook
    from .run import evaluate as run

    if threads is not None:
        torch.set_num_threads(threads)
    engines = checked_engines(engine or (DEFAULT_ENGINE,))
    sizes = [Size.parse(text) for text in size or ()]
    plans = evaluation_plans(scenes or (), generated, inputs or (), sizes, model or (), seed, whole=whole)
    with ProgressBars(quiet=quiet) as bars:
        bars.say(outlook(plans, model or (), len(engines)))
        try:
            with enough_memory("evaluate"):
                report = run(
                    plans,
                    out,
                    files=model or (),
                    engines=engines,
                    lpips=lpips or default_weights(),
                    twice=twice,
                    fade=checked_passes(fade),
                    threads=threads,
                    listener=bars,
                )
        except CheckpointError as error:
            raise ModelError(str(error), field="model") from error
        except OutOfMemory as error:
            raise GapmesError(str(error)) from error
    for scene, line in dict.fromkeys(pair for group in report.groups for pair in group.told):
        bars.say(f"{scene}: {line}")
    missed = [floor for floor in report.floors if floor.passed is False]
    for floor in report.floors:
        verdict = {True: "pass", False: "MISSED", None: "-"}[floor.passed]
        bars.say(f"{verdict:6}  {floor.name}: {floor.value} (need {floor.need})")
    bars.say(f"wrote {out / 'report.json'}, {out / 'report.md'} and a picture per scene")
    if as_json:
        write_result(report.document())
    if check and missed:
        raise typer.Exit(FLOOR_MISSED)
