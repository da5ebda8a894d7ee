"""`make bench-splat`: product and plain renderer, in turns on the same scenes; medians, ratios, stages, agreement."""

from __future__ import annotations

import argparse
import importlib.util
import platform
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numba

from gapmes.service.cameras.camera import Camera
from gapmes.service.captures.capture import read_camera_file
from gapmes.service.formats.ply import read_ply
from gapmes.service.gaussians import Gaussians
from gapmes.service.kernels import warm_up
from gapmes.service.process.threads import available_threads

from ..options import at_least_one, refusals_told
from .measure import Other, Row, measure
from .peak import peak_gflops
from .scenes import camera, surface_scene
from .starts import first_and_later

SIZES = (256, 1024)  # px, of pictures of given scenes
FLOORS = {(131_072, 256): 7.0, (131_072, 1024): 18.0, (500_000, 1024): 12.0}  # splats, px: times the plain renderer
CASES = (  # splats, SH degree, px; and what the ratio to the plain renderer must reach
    *(
        (count, degree, px, FLOORS.get((count, px)) if degree == 0 else None)
        for count in (65_536, 131_072, 500_000)
        for px in (256, 1024)
        for degree in (0, 3)
    ),
    (1_000_000, 0, 1024, None),
)
NEED_SCALING, NEED_HARMONICS = 1.7, 1.35  # one thread against two at 131,072 splats and 1024 px; SH 3 against SH 0
NEED_FIRST, NEED_LATER = 5.0, 0.5  # s, the first call with an empty cache of compiled loops, and with a filled one


def other_renderer(path: Path) -> Other:
    """`renderer(gaussians, threads)` of a Python file: returns a function from a camera to (H, W, 3) colours."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return Other(path.stem, module.renderer)


def trained_scene(path: Path, cameras: Path | None, size: int) -> tuple[Gaussians, Camera]:
    """A .ply and the first of its cameras, at a width of `size` px; without cameras, the view from the origin."""
    gaussians = read_ply(path)
    if cameras is None:
        return gaussians, camera(size)
    view = read_camera_file(cameras).views[0].camera
    return gaussians, view.resized(size, round(size * view.height / view.width))


def verdicts(rows: list[tuple[Row, float | None]]) -> list[str]:
    """The requirements, and whether each is met."""
    lines = []

    def say(what: str, value: float, need: float, reached: bool) -> None:
        lines.append(f"{what}: {value:.2f}, need {need:g}: {'reached' if reached else 'MISSED'}")

    for row, floor in rows:
        if floor is not None and row.ratio is not None:
            say(f"{row.name} at {row.px} px, times the plain renderer", row.ratio, floor, row.ratio >= floor)
        if row.harmonics is not None and "SH 3" in row.name:  # of the scenes above, not of others
            reached = row.harmonics <= NEED_HARMONICS
            say(f"{row.name} at {row.px} px, times SH 0", row.harmonics, NEED_HARMONICS, reached)
    large = [row for row, _ in rows if row.px == 1024 and "SH 0" in row.name]
    for row in large:
        if row.count == 131_072 and row.scaling is not None:
            say("one thread to two", row.scaling, NEED_SCALING, row.scaling >= NEED_SCALING)
    if len(large) > 1:
        growth = (large[-1].milliseconds / large[0].milliseconds) / (large[-1].count / large[0].count)
        say(f"time per splat at {large[-1].count:,}, times that at {large[0].count:,}", growth, 1.0, growth <= 1.0)
    return lines


@refusals_told()
def main() -> None:
    """Print the table; see --help."""
    parser = argparse.ArgumentParser(prog="make bench-splat", description=__doc__)
    parser.add_argument("--repeats", type=at_least_one, default=9, help="runs of each renderer, in turns (9)")
    parser.add_argument(
        "--threads", type=at_least_one, default=available_threads(), help="threads of each renderer (all)"
    )
    parser.add_argument("--quick", action="store_true", help="only 131,072 splats")
    parser.add_argument("--ply", type=Path, action="append", default=[], help="a trained scene to draw as well")
    parser.add_argument("--cameras", type=Path, action="append", default=[], help="its camera file, in the same order")
    parser.add_argument(
        "--other", type=Path, action="append", default=[], help="a Python file with renderer(gaussians, threads)"
    )
    options = parser.parse_args()
    if len(options.cameras) > len(options.ply):
        parser.error(f"{len(options.cameras)} camera files for {len(options.ply)} scenes")
    for path in (*options.ply, *options.cameras, *options.other):
        if not path.is_file():
            parser.error(f"{path} is no file")
    cameras = [*options.cameras, *[None] * len(options.ply)]
    for path, file in zip(options.ply, cameras, strict=False):
        trained_scene(path, file, SIZES[0])  # what is refused is refused before minutes of measurements
    start = time.perf_counter()
    warm_up()
    ready, peak = time.perf_counter() - start, peak_gflops(options.threads)
    print(f"{platform.processor() or platform.machine()}, {options.threads} threads, numba {numba.__version__}; "
          f"kernels ready after {ready:.2f} s; peak {peak:.0f} GFLOP/s")  # fmt: skip
    others = [other_renderer(path) for path in options.other]
    todo: list[tuple[str, Callable[[], tuple[Gaussians, Camera]], float | None]] = [
        (f"{count:,} SH {degree}", lambda c=count, d=degree, s=size: (surface_scene(c, d), camera(s)), floor)
        for count, degree, size, floor in CASES
        if count == 131_072 or not options.quick
    ]
    for path, file in zip(options.ply, cameras, strict=False):
        for size in SIZES:
            todo.append((path.stem, lambda p=path, f=file, s=size: trained_scene(p, f, s), None))
    rows = []
    for name, make, floor in todo:
        gaussians, view = make()
        print(f"{name} at {view.width} px ...", file=sys.stderr, flush=True)
        row = measure(name, gaussians, view, options.repeats, options.threads, others, peak)
        rows.append((row, floor))
    columns = list(dict.fromkeys(key for row, _ in rows for key in row.cells()))
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    for row, _ in rows:
        print("| " + " | ".join(row.cells().get(key, "") for key in columns) + " |")
    lines = verdicts(rows)
    for name, seconds, need in zip(
        ("first picture, s", "first picture of a later process, s"),
        first_and_later(),
        (NEED_FIRST, NEED_LATER),
        strict=True,
    ):
        lines.append(f"{name}: {seconds:.2f}, need {need:g}: {'reached' if seconds <= need else 'MISSED'}")
    print("\n".join(lines))
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")
    if any("MISSED" in line for line in lines):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
