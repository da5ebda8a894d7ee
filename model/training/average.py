"""`python -m gapmes.model.training.average OUT.safetensors RUN.safetensors ...`: the mean of several runs' weights.

Runs that continue from the same weights end in one basin of the loss, each displaced by the noise of its last steps.
Their mean lies closer to the centre (model soups, Wortsman et al. 2022), and is as fast as one network.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import torch

from ..checkpoint import load_checkpoint, read_config, read_metadata, save_checkpoint
from ..network import GaPMeS
from ..weights_file import CheckpointError, file_sha256, why_no_file
from .differences import differences
from .start import BEGUN, SEEDS, seeds_of, seeds_text

MEAN_OF = "gapmes.mean_of"  # sha256 of every file that went in, in the checkpoint's metadata


def averaged(paths: Sequence[Path]) -> GaPMeS:
    """The network whose trained parameters are the means over all files, computed in float64, and whose frozen parts
    are those of every file.

    Raises `CheckpointError` for fewer than two files, and for one that has another configuration or other frozen parts
    than the first.
    """
    if len(paths) < 2:
        raise CheckpointError(f"weights: {len(paths)} given, need at least 2 for a mean")
    config = read_config(paths[0])
    for path in paths[1:]:
        if (found := read_config(path)) != config:
            raise CheckpointError(
                f"{path} has another configuration than {paths[0]}: "
                f"{differences(asdict(found), asdict(config), other='there')}; "
                "only runs of one network have a mean"
            )
    models = [load_checkpoint(path) for path in paths]
    with torch.no_grad():
        for (name, first), *others in zip(*(model.named_parameters() for model in models), strict=True):
            if first.requires_grad:
                first.copy_(torch.stack([first.double(), *(value.double() for _, value in others)]).mean(0))
                continue
            for path, (_, value) in zip(paths[1:], others, strict=True):
                if not torch.equal(value, first):
                    raise CheckpointError(
                        f"{path} has other frozen parts than {paths[0]}: {name} differs; average runs that were begun "
                        "with the same published weights"
                    )
    return models[0]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gapmes.model.training.average", description=__doc__)
    parser.add_argument("out", type=Path, help="file to write; replaced only when all is well")
    parser.add_argument("weights", type=Path, nargs="+", metavar="FILE", help="checkpoints of runs of one network")
    options = parser.parse_args(arguments)
    files = [options.out, *options.weights]
    places = [path.resolve() for path in files]
    for place, path in enumerate(files):
        if places[place] in places[:place]:
            parser.error(f"{path} is given twice: it would count so in the mean, or be overwritten by it")
    if options.out.is_dir():  # the name of none, also "", cannot be written beside
        return _refused(options.out, "it is a folder")
    try:
        for path in options.weights:
            if not path.is_file():
                parser.error(why_no_file(path))
        digests = [file_sha256(path) for path in options.weights]
        for place, digest in enumerate(digests):
            if digest in digests[:place]:
                same = options.weights[digests.index(digest)]
                parser.error(f"{options.weights[place]} holds the same weights as {same}: they would count twice")
        model = averaged(options.weights)
        records = [read_metadata(path) for path in options.weights]
    except (CheckpointError, OSError) as error:
        parser.error(str(error))
    begun = {record[BEGUN] for record in records if BEGUN in record} - {*digests}
    if len(begun) > 1:
        sys.stderr.write(
            f"warning: the runs began from {len(begun)} different weights ({', '.join(sorted(begun))}); unless one run "
            "went on from another, their mean is worse than each\n"
        )
    seeds = set[int]().union(*map(seeds_of, records))
    extra = {MEAN_OF: ",".join(digests)} | ({SEEDS: seeds_text(seeds)} if seeds else {})
    try:
        save_checkpoint(options.out, model, extra=extra)
    except OSError as error:
        return _refused(options.out, error.strerror or str(error))
    sys.stdout.write(f"{options.out}: mean of {len(digests)} files\n")
    return 0


def _refused(out: Path, reason: str) -> int:
    sys.stderr.write(f"refused: {out} cannot be written: {reason}; name another place\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
