"""The benchmarks' own arithmetic and usage: quantiles, rates, means by kind of scene, cells of what did not run."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
HERE = str(Path(__file__).parent)


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch):
    """Imports a module of `benchmarks`."""
    monkeypatch.syspath_prepend(ROOT)
    return lambda name: importlib.import_module(f"benchmarks.{name}")


def test_no_quantile_of_few_times_is_above_the_longest(benchmark) -> None:
    load = benchmark("load.run").Load()
    load.seconds["scene"], load.active["scene"] = [2.0, 3.0, 4.0, 9.0], 20.0
    line = load.line("scene", 2)
    assert "p50 3500 ms, p95 8250 ms, p99 8850 ms" in line
    assert " 0.40 per second" in line  # two clients that had four answers in 20 s together


def test_the_rate_counts_the_time_that_the_last_answer_took(benchmark, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client that is to ask for 10 s has two answers, after 8 s each."""
    module = benchmark("load.run")
    clock = SimpleNamespace(now=0.0)

    def answered(_: object) -> SimpleNamespace:
        clock.now += 8.0
        return SimpleNamespace(status_code=201)

    monkeypatch.setattr(module.Asker, "scene", answered)
    times = SimpleNamespace(monotonic=lambda: clock.now, perf_counter=lambda: clock.now)
    monkeypatch.setattr(module, "time", times)
    load = module.Load()
    load.clients(SimpleNamespace(address="http://127.0.0.1:9"), [], 0, 1, 10.0)
    assert load.seconds["scene"] == [8.0, 8.0]
    assert " 0.12 per second" in load.line("scene", 1)  # 2 in 16 s


def test_what_did_not_run_has_an_empty_cell(benchmark, monkeypatch: pytest.MonkeyPatch) -> None:
    """The plain renderer on many splats, and two threads where all renderers have one."""
    measuring = benchmark("splat.measure")
    scene, view = benchmark("splat.scenes").surface_scene(64, 0), benchmark("splat.scenes").camera(16)
    found = []
    for threads, most in ((1, 0), (2, 64)):
        monkeypatch.setattr(measuring, "PLAIN_UP_TO", most)
        found.append(measuring.measure("a", scene, view, 1, threads, [], 1.0).cells())
    names = ("x plain", "dB to plain", "one to two threads")
    assert [[cells[name] != "" for name in names] for cells in found] == [[False] * 3, [True] * 3]


@pytest.mark.parametrize(
    ("module", "options", "told"),
    [
        ("splat.run", ["--ply", "none.ply"], "none.ply is no file"),
        ("splat.run", ["--cameras", __file__], "1 camera files for 0 scenes"),
        ("scene.detail", [], "no scenes: name a SCENE_DIR"),
        ("scene.detail", ["/nowhere"], "argument SCENE_DIR: /nowhere does not exist"),
        ("scene.formats", ["/nowhere"], "argument SCENE_DIR: /nowhere does not exist"),
        ("scene.leaving_out", ["/nowhere"], "argument SCENE_DIR: /nowhere does not exist"),
        ("stages", ["/nowhere"], "argument capture: /nowhere does not exist"),
        ("network.profile", ["none.onnx"], "argument MODEL.onnx: none.onnx does not exist"),
        ("network.rounding", [__file__], "names 1 files, need 2, with = between them"),
        ("network.rounding", [f"{__file__}=none"], "none does not exist"),
        ("network.run", ["a=b=c=d"], "a=b=c=d names 4 files, need 1 to 3, with = between them"),
        ("viewer.compare", ["--chromium", sys.executable, "--view", "8"], "has 8 views: need 0 to 7"),
        ("viewer.compare", ["--cameras", "none.json"], "argument --cameras: none.json does not exist"),
        ("viewer.compare", ["--ply", "none.ply"], "argument --ply: none.ply does not exist"),
        ("viewer.compare", ["--chromium", "no-such-browser"], "no-such-browser is no command here"),
    ],
)
def test_wrong_usage_is_told_before_the_work(
    module: str,
    options: list[str],
    told: str,
    benchmark,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = benchmark(module)
    for name in ("warm_up", "Reconstructor", "subprocess"):
        monkeypatch.setattr(found, name, None, raising=False)
    monkeypatch.setattr(found, "VIEWER", tmp_path, raising=False)
    monkeypatch.setattr("sys.argv", ["benchmark", *options])
    with pytest.raises(SystemExit) as ended:
        found.main()
    assert told in f"{ended.value} {capsys.readouterr().err}"


@pytest.mark.parametrize(
    ("module", "options", "told"),
    [
        *(
            (module, [*more, "--rounds", rounds], f"argument --rounds: is {rounds}, need at least 1")
            for module, more in (
                ("network.experts", []),
                ("network.profile", [__file__]),
                ("network.run", [f"{__file__}={__file__}"]),
                ("scene.leaving_out", [HERE]),
                ("stages", []),
            )
            for rounds in ("0", "-1")
        ),
        ("load.faults", ["--seconds", "0"], "argument --seconds: is 0, need more than 0"),
        ("load.faults", ["--seconds", "nan"], "argument --seconds: is nan, need more than 0"),
        ("load.faults", ["--workers", "0"], "argument --workers: is 0, need at least 1"),
        ("load.faults", ["--seed", "-1"], "argument --seed: is -1, need at least 0"),
        ("load.run", ["--minutes", "-1"], "argument --minutes: is -1, need more than 0"),
        ("load.run", ["--workers", "0"], "argument --workers: is 0, need at least 1"),
        ("load.run", ["--pictures", "-1"], "argument --pictures: is -1, need at least 0"),
        ("load.run", ["--scenes", "two"], "argument --scenes: invalid whole number value: 'two'"),
        ("network.profile", [__file__, "--views", "0"], "argument --views: is 0, need at least 2"),
        ("network.profile", [__file__, "--views", "7"], "argument --views: is 7, need at most 6"),
        ("network.profile", [__file__, "--depth", "0"], "argument --depth: is 0, need at least 1"),
        (
            "network.rounding",
            [f"{__file__}={__file__}", "--views", "0"],
            "argument --views: is 0, need at least 2",
        ),
        ("network.run", [f"{__file__}={__file__}", "--views", "1"], "argument --views: is 1, need at least 2"),
        ("scene.detail", ["--generated", "-1"], "argument --generated: is -1, need at least 0"),
        ("scene.detail", [HERE, "--inputs", "0"], "argument --inputs: is 0, need at least 2"),
        ("scene.detail", [HERE, "--fade", "9"], "argument --fade: is 9, need at most 8"),
        ("scene.formats", ["--fade", "-1"], "argument --fade: is -1, need at least 0"),
        ("scene.leaving_out", [HERE, "--fade", "-1"], "argument --fade: is -1, need at least 0"),
        ("splat.run", ["--repeats", "0"], "argument --repeats: is 0, need at least 1"),
        ("splat.run", ["--threads", "0"], "argument --threads: is 0, need at least 1"),
        ("viewer.compare", ["--size", "0"], "argument --size: is 0, need at least 1"),
    ],
)
def test_numbers_out_of_bounds_are_wrong_usage(
    module: str,
    options: list[str],
    told: str,
    benchmark,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Some ended in a traceback after minutes of work, or measured nothing."""
    found = benchmark(module)

    def begun(*_: object, **__: object) -> None:
        raise AssertionError("the work has begun")

    for name in ("warm_up", "Reconstructor", "running", "subprocess", "measure", "profiled", "told_intel", "onnx"):
        if hasattr(found, name):
            monkeypatch.setattr(found, name, begun)
    monkeypatch.setattr("sys.argv", ["benchmark", *options])
    with pytest.raises(SystemExit) as ended:
        found.main()
    assert ended.value.code == 2
    assert told in capsys.readouterr().err


def test_means_of_photographs_and_of_generated_scenes_are_apart(
    benchmark, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only the former have targets at the network's own size."""
    detail = benchmark("scene.detail")
    values = iter(range(20, 28))
    target = SimpleNamespace(image=None)

    def row(_service: object, found: tuple, *_: object) -> tuple[object, None]:
        seen = detail.Figures(float(next(values)), None, None)
        nothing = detail.Figures(None, None, None)
        return detail.Row(seen, seen if found[2] else nothing, 1.0, 1.0, 1.0), None

    monkeypatch.setattr(detail, "Reconstructor", lambda: SimpleNamespace(engine=SimpleNamespace(info=size)))
    size = SimpleNamespace(height=32, width=32)
    for name, own in (("photographs", [target]), ("generated", ())):
        scenes = [(SimpleNamespace(name=f"{name} {number}"), [target], own) for number in range(2)]
        monkeypatch.setattr(detail, name, lambda *_, scenes=scenes: scenes)
    monkeypatch.setattr(detail, "row", row)
    monkeypatch.setattr(detail, "drawn", lambda *_: np.zeros(0))
    monkeypatch.setattr(detail, "default_weights", lambda: None)
    monkeypatch.setattr("sys.argv", ["detail", HERE, __file__, "--generated", "2"])
    detail.main()
    means = [line for line in capsys.readouterr().out.splitlines() if "mean" in line]
    assert [line.split("|")[1:4] for line in means] == [
        [" mean of 2 photographs, 1 ", " 21.00 / - / - ", " 21.00 / - / - "],
        [" mean of 2 photographs, 2 ", " 22.00 / - / - ", " 22.00 / - / - "],
        [" mean of 2 generated scenes, 1 ", " 25.00 / - / - ", " - / - / - "],
        [" mean of 2 generated scenes, 2 ", " 26.00 / - / - ", " - / - / - "],
    ]


def test_onnxruntime_to_which_ratios_refer_always_runs(benchmark, monkeypatch: pytest.MonkeyPatch) -> None:
    network = benchmark("network.run")

    @contextmanager
    def worker(name: str, *_: object) -> Iterator[SimpleNamespace]:
        yield SimpleNamespace(name=name, run=lambda: None, rows=[])

    monkeypatch.setattr(network, "worker", worker)
    for checkpoint, others in ((None, []), (Path("a.safetensors"), ["torch"])):
        timed = network.compare(Path("a.onnx"), checkpoint, None, 2, 1, {}, ["torch"])
        assert [one.name for one in timed] == ["matrix product", "onnxruntime", *others]


@pytest.mark.parametrize("counted", [True, False])
def test_operations_that_nothing_counted_are_not_told(benchmark, counted: bool) -> None:
    """Torch counts them."""
    names = ["matrix product", "onnxruntime", *(["torch"] if counted else [])]
    rows = [{"operations": 3e9}]
    timed = [SimpleNamespace(name=name, rows=rows, median=lambda what="cpu": 1.0) for name in names]
    *lines, last = benchmark("network.run").table(timed)
    assert ("; the network has 3.0 GFLOP" in last) == counted
    assert all((" 100% " in line) == counted for line in lines)


@pytest.mark.parametrize("name", ["stages", "scene.formats", "scene.leaving_out", "scene.detail", "splat.run"])
def test_what_is_refused_is_a_line(benchmark, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is measured."""
    (tmp_path / "empty.ply").touch()
    option = ["--ply"] if name == "splat.run" else []
    monkeypatch.setattr("sys.argv", [name, *option, str(tmp_path / "empty.ply")])
    module = benchmark(name)
    monkeypatch.setattr(module, "warm_up", None, raising=False)
    with pytest.raises(SystemExit, match=r"^error: "):
        module.main()
