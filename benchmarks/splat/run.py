"""`make bench-splat`: product and plain renderer in turns on the same scenes; medians, ratios, stages, agreement."""

from __future__ import annotations

import argparse
import platform
import resource
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np

from gapmes.service.gaussians import Gaussians
from gapmes.service.ply import read_ply
from gapmes.service.splat import render, warm_up
from gapmes.service.threads import available_threads

from .peak import peak_gflops
from .plain import PlainRenderer
from .scenes import camera, surface_scene

CASES = (  # splats, SH degree, px; and what the ratio to the plain renderer must reach
    (65_536, 0, 256, None), (65_536, 0, 1024, None), (131_072, 0, 256, 7.0), (131_072, 0, 1024, 18.0),
    (131_072, 3, 1024, None), (500_000, 0, 256, None), (500_000, 0, 1024, 12.0), (500_000, 3, 1024, None),
    (1_000_000, 0, 1024, None),
)  # fmt: skip


def timed(work: Callable[[], object]) -> float:
    """Seconds of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def measure(name: str, gaussians: Gaussians, size: int, repeats: int, threads: int, plainly: bool) -> dict[str, object]:
    """One scene: the product with one thread and with all, and the plain renderer, in turns."""
    view = camera(size)
    plain = PlainRenderer(gaussians)
    runs: dict[str, Callable[[], object]] = {
        "all": lambda: stages.append(render(gaussians, view, threads=threads, outputs=()).stats["seconds"]),
        "one": lambda: render(gaussians, view, threads=1, outputs=()),
    }
    if plainly:
        runs["plain"] = lambda: plain(view)
    stages: list[dict[str, float]] = []
    for work in runs.values():
        work()
    stages.clear()
    seconds: dict[str, list[float]] = {key: [] for key in runs}
    for _ in range(repeats):
        for key, work in runs.items():
            seconds[key].append(timed(work))
    medians = {key: statistics.median(values) for key, values in seconds.items()}
    result: dict[str, object] = {"scene": name, "px": size, **{f"{k} ms": 1e3 * v for k, v in medians.items()}}
    if plainly:
        difference = np.abs(plain(view) - render(gaussians, view, outputs=()).rgb)
        result["ratio"] = medians["plain"] / medians["all"]
        result["agree"] = -10 * np.log10(float((difference**2).mean()) + 1e-30)
    result["1 to all"] = medians["one"] / medians["all"]
    for stage in stages[0]:
        result[stage] = 1e3 * statistics.median(row[stage] for row in stages)
    return result


def main() -> None:
    """Print the table; see --help."""
    parser = argparse.ArgumentParser(prog="make bench-splat", description=__doc__)
    parser.add_argument("--repeats", type=int, default=9, help="of each renderer, in turns (9)")
    parser.add_argument("--threads", type=int, default=available_threads(), help="of both renderers (all)")
    parser.add_argument("--quick", action="store_true", help="only 131,072 splats")
    parser.add_argument("--ply", type=Path, action="append", default=[], help="a trained scene to draw as well")
    options = parser.parse_args()
    numba.config.THREADING_LAYER = "workqueue"  # its idle threads sleep; the others' spin against whoever comes next
    numba.set_num_threads(options.threads)
    start = time.perf_counter()
    warm_up()
    print(f"{platform.processor() or platform.machine()}, {options.threads} threads, numba {numba.__version__}; "
          f"kernels ready after {time.perf_counter() - start:.2f} s; "
          f"peak {peak_gflops(options.threads):.0f} GFLOP/s")  # fmt: skip
    rows, floors = [], []
    for count, degree, size, floor in CASES:
        if options.quick and count != 131_072:
            continue
        name = f"{count:,} SH {degree}"
        print(f"{name} at {size} px ...", file=sys.stderr, flush=True)
        row = measure(name, surface_scene(count, degree), size, options.repeats, options.threads, count <= 500_000)
        rows.append(row)
        if floor is not None:
            verdict = "reached" if float(str(row["ratio"])) >= floor else "MISSED"
            floors.append(
                f"{name} at {size} px: {row['ratio']:.1f} times the plain renderer, need {floor:g}: {verdict}"
            )
    for path in options.ply:
        rows.append(measure(path.stem, read_ply(path), 512, options.repeats, options.threads, True))
    columns = list(dict.fromkeys(key for row in rows for key in row))
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    for row in rows:
        cells = [row.get(key, "") for key in columns]
        print("| " + " | ".join(f"{c:.1f}" if isinstance(c, float) else str(c) for c in cells) + " |")
    print("\n".join(floors))
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
