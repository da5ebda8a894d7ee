"""Train a preset on generated scenes, with frozen parts from published weights; continue an interrupted run."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from gapmes.service.process.terminal import QUIET_HELP, ProgressBars

from ..checkpoint import load_checkpoint, read_metadata
from ..config import PRESETS, ModelConfig, preset
from ..pretrained.backbones import BackboneSources
from ..pretrained.sources import resolve
from ..weights_file import CheckpointError
from . import arguments as kinds
from .log_rows import read_rows
from .loop import train
from .recipe import RECIPES
from .run_folder import LOG, STATE, WEIGHTS, Refused
from .start import check_start, seeds_of
from .training_run import SAVE_SECONDS, TrainingRun
from .workers import Worker, run_workers

BEGINS_ANEW = f"begins anew: it saves a state every {SAVE_SECONDS:.0f} s, and had saved none"
ABLATED = {"depth": "no depth stream", "experts": "no experts and no gate for them", "tasks": "no task gate"}


@dataclass(frozen=True)
class Part:
    """A frozen part that published weights go into."""

    name: str
    help: str


PARTS = (
    Part("semantic", "DINOv2's weights"),
    Part("depth", "Depth-Anything-V2's weights"),
    Part("trunk", "UniMatch's or DepthSplat's weights"),
)


def main(arguments: list[str] | None = None) -> int:
    parser = _parser()
    options = parser.parse_args(arguments)
    run = _asked(parser, options)
    try:
        _check_sources(run, options.quiet)
    except CheckpointError as error:
        parser.error(str(error))
    try:
        run_workers(options.processes, options.threads, _train, run, options.quiet)
    except (Refused, CheckpointError, OSError) as error:
        sys.stderr.write(f"refused: {error}\n")
        if options.json:
            sys.stdout.write(json.dumps({"error": {"detail": str(error)}}) + "\n")
        return 1
    except KeyboardInterrupt:
        saved = (run.folder / STATE).is_file()
        sys.stderr.write(f"stopped; the same command {'goes on from the last state' if saved else BEGINS_ANEW}\n")
        return 130
    if options.json:
        log = run.folder / LOG
        rows = read_rows(log) if log.is_file() else []  # a run of no steps has none
        last = rows[-1] if rows else None
        sys.stdout.write(json.dumps({"weights": str(run.folder / WEIGHTS), "last": last}) + "\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m gapmes.model.training", description=__doc__)
    parser.add_argument("out", type=kinds.folder, help="folder of the run; an interrupted run continues from it")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="tiny")
    parser.add_argument("--recipe", choices=sorted(RECIPES), default="whole", help="finish: further steps after a run")
    parser.add_argument("--initial-weights", type=Path, metavar="FILE", help="start from this checkpoint of the preset")
    parser.add_argument("--steps", type=kinds.whole_number(0), help="default: the recipe's; 0 trains nothing")
    parser.add_argument("--seed", type=kinds.seed(), help="default: the recipe's; it decides which scenes are drawn")
    parser.add_argument("--scenes", type=kinds.whole_number(1), help="scenes per step (default: the recipe's, 2 to 4)")
    parser.add_argument(
        "--processes", type=kinds.whole_number(1), default=1, help="share each step's scenes evenly (default 1)"
    )
    parser.add_argument(
        "--threads", type=kinds.threads(), default=1, help="per process; one is fastest on shared cores (default 1)"
    )
    parser.add_argument(
        "--loaders",
        type=kinds.whole_number(0),
        default=0,
        help="processes that generate the next scenes of each process: with a graphics card, as many as there are "
        "idle cores (default 0: each step generates its own)",
    )
    parser.add_argument(
        "--device", type=kinds.device, default="auto", help="cpu, cuda, or auto (default): cuda if there is one"
    )
    parser.add_argument("--validate-every", type=kinds.whole_number(1), default=250, metavar="STEPS")
    parser.add_argument("--json", action="store_true", help="print the last figures, or a refusal, to stdout as JSON")
    parser.add_argument("-q", "--quiet", action="store_true", help=QUIET_HELP)
    for name, what in ABLATED.items():
        parser.add_argument(f"--without-{name}", action="store_true", help=f"ablation: {what}")
    for part in PARTS:
        text = f"{part.help} for a preset with frozen parts: a file, a folder or a hub name"
        parser.add_argument(f"--{part.name}-weights", metavar="SOURCE", help=text)
    return parser


def _asked(parser: argparse.ArgumentParser, options: argparse.Namespace) -> TrainingRun:
    """The run that the options describe. Options that do not go together are wrong usage."""
    config = preset(
        options.preset,
        without_depth=options.without_depth,
        without_experts=options.without_experts,
        without_tasks=options.without_tasks,
    )
    backbones = _backbones(parser, options, config)
    chosen = {name: value for name in ("steps", "seed") if (value := getattr(options, name)) is not None}
    recipe = replace(RECIPES[options.recipe], **chosen)
    if options.scenes is not None:
        recipe = recipe.with_scenes(options.scenes)
    if uneven := recipe.not_shared_by(options.processes):
        parser.error(f"argument --processes: {uneven}")
    return TrainingRun(
        config,
        recipe,
        options.out,
        validate_every=options.validate_every,
        device=options.device,
        backbones=backbones,
        initial=options.initial_weights,
        loaders=options.loaders,
    )


def _backbones(
    parser: argparse.ArgumentParser, options: argparse.Namespace, config: ModelConfig
) -> BackboneSources | None:
    """The published weights of the frozen parts, which a run needs that does not start from weights of ours."""
    sources = {part.name: getattr(options, f"{part.name}_weights") for part in PARTS}
    frozen = [part.name for part in PARTS if part.name != "depth" or not config.without_depth]
    start = options.initial_weights
    needed = frozen if config.freeze_vits and start is None else []  # it would freeze random ones
    if lacking := [name for name in needed if sources[name] is None]:
        names = ", ".join(f"--{name}-weights" for name in lacking)
        parser.error(f"preset {config.preset} has frozen parts, which need published weights: give {names}")
    if start is None and options.recipe == "finish":
        parser.error("recipe finish goes on from trained weights: give --initial-weights")
    if start is not None and start.resolve().parent == options.out.resolve():
        parser.error(f"--initial-weights {start} lies in the run's own folder and would be overwritten: use another")
    if extra := [name for name, source in sources.items() if source is not None and name not in needed]:
        if start is not None:
            parser.error(f"{start} carries its frozen parts: leave out --{extra[0]}-weights")
        parser.error(f"preset {config.preset} has no such frozen part: leave out --{extra[0]}-weights")
    return BackboneSources(**sources) if needed else None


def _check_sources(run: TrainingRun, quiet: bool) -> None:
    """Before processes start and there is a folder. Raises `CheckpointError` for weights that are not there, and for
    weights to start from that do not fit; says so when these have seen the run's scenes."""
    if run.backbones is not None:
        for part in PARTS:
            source = getattr(run.backbones, part.name)
            if source is not None:
                resolve(source)
    if run.initial is not None:
        check_start(run.initial, run.config)
        load_checkpoint(run.initial)  # tensors that are none are wrong usage too
        seed = run.recipe.seed
        if seed in seeds_of(read_metadata(run.initial)) and not quiet:
            sys.stderr.write(f"{run.initial} was trained with seed {seed}: another --seed draws other scenes\n")


def _train(worker: Worker, run: TrainingRun, quiet: bool) -> None:
    level = logging.INFO if worker.leads and not quiet else logging.WARNING
    with ProgressBars(quiet=quiet or not worker.leads) as bars:
        logging.basicConfig(level=level, format="%(asctime)s %(message)s", stream=sys.stderr)  # above the bar
        train(run, worker=worker, listener=bars)
        logging.getLogger(__name__).info("weights: %s", run.folder / WEIGHTS)
