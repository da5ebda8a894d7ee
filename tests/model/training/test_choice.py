"""The choice among candidates: its torch twin, its training data, its training, and the command."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from functools import cache, partial
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
import pytest
import torch

from gapmes.model.training import choice, choice_data
from gapmes.model.training.choice import held_out
from gapmes.model.training.choice_data import PIXELS, Samples, scene_batch, scene_samples
from gapmes.model.training.generated_views import input_views
from gapmes.model.training.scenes import SceneBatch
from gapmes.service import Reconstructor
from gapmes.service.cameras.depth_range import depth_range
from gapmes.service.mending.after_network import matched_depths
from gapmes.service.mending.choice.candidates import ABOUT, COUNT, KNOWN, Candidates, Matched
from gapmes.service.mending.choice.network import ChoiceNetwork
from gapmes.service.photographs.images import FittedView

SCENE = (3, 2)  # seed and number


def made_up(count: int, seed: int) -> Samples:
    """40 scenes in which the right candidate has the largest first feature."""
    rng = np.random.default_rng(seed)
    known = rng.normal(size=(COUNT, KNOWN, count)).astype(np.float16)
    error = np.where(known[:, 0] == known[:, 0].max(axis=0), 0.1, 9.0).astype(np.float32)
    about = rng.normal(size=(ABOUT, count)).astype(np.float16)
    return Samples(known, about, error, np.arange(count) % 40)


def test_the_service_computes_what_was_trained() -> None:
    torch.manual_seed(0)
    network, samples = choice.Choice(), made_up(50, 1)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.normal_(0, 0.3)
        known, about = (torch.from_numpy(np.moveaxis(values, -1, 0)).float() for values in samples[:2])
        scores = network(known, about)
    found = network.exported().preferences(samples.known, samples.about)
    np.testing.assert_allclose(found, scores.softmax(1).numpy().T, atol=1e-6)


def test_it_learns_which_candidate_is_right_and_the_same_again() -> None:
    samples = made_up(8_000, 2)
    networks = [choice.trained(samples, 7, 20).exported() for _ in range(2)]
    assert all((value == getattr(networks[1], name)).all() for name, value in vars(networks[0]).items())
    found = choice.figures(choice.trained(samples, 7, 300).exported(), samples)
    assert found["as it is"][1] < 0.2
    assert found["preferred"][1] > 0.9  # found: 0.98
    assert found["best"] == pytest.approx((0.1 / 1.6, 1.0), rel=1e-4)


class Drawn(NamedTuple):
    """The samples of a scene, and the depths that its candidates were made from."""

    reconstructor: Reconstructor
    samples: Samples | None
    depths: tuple[np.ndarray, ...]


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    heard: list[tuple[np.ndarray, ...]] = []

    class Listening(Matched):
        def __init__(self, views: list[FittedView], depths: np.ndarray, others: tuple[np.ndarray, ...]) -> None:
            heard.append((depths, *others))
            super().__init__(views, depths, others)

    reconstructor = Reconstructor(None, threads=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(choice_data, "Matched", Listening)
        samples = scene_samples(reconstructor, *SCENE)
    (depths,) = heard
    return Drawn(reconstructor, samples, depths)


def test_samples_of_a_scene_have_their_shapes_and_are_the_same_again(drawn: Drawn) -> None:
    samples, again = drawn.samples, scene_samples(drawn.reconstructor, *SCENE)
    assert samples is not None
    assert again is not None
    assert all((a == b).all() for a, b in zip(samples, again, strict=True))
    assert 0 < samples.error.shape[1] <= 2 * PIXELS
    assert samples.known.shape[:2] == (COUNT, KNOWN)
    assert len(samples.about) == ABOUT
    assert (samples.scene == SCENE[1]).all()


def test_candidates_are_those_of_the_service(drawn: Drawn) -> None:
    """In the order of `mending.py`: what is found, the network's own, that before planes."""
    planed, network, matched = drawn.depths
    batch = scene_batch(*SCENE)
    views, (near, far) = input_views(batch), map(float, batch.near_far[0])
    outputs, frame, _ = drawn.reconstructor.run_network(views, depth_range([view.camera for view in views], near, far))
    assert (network == frame.depths(outputs)).all()
    expected = matched_depths(views, network, 1)
    assert (matched == expected[0]).all()
    assert (planed == expected[1]).all()
    assert not (matched == planed).all()


@cache
def with_a_sky() -> SceneBatch:
    return next(batch for batch in map(partial(scene_batch, 5), range(30)) if batch.background[0, :2].mean() > 0.3)


@pytest.mark.parametrize("index", [0, 1])
def test_errors_are_px_of_parallax_from_the_true_depth_and_a_sky_is_infinitely_far(index: int) -> None:
    batch, way = with_a_sky(), 37.0
    sky, depth = batch.background[0, index], batch.depths[0, index].astype(np.float64)
    true = np.array([0.0 if there else way / z for there, z in zip(sky.ravel(), depth.ravel(), strict=True)])
    undecided = np.zeros(sky.shape, bool)
    undecided[40:200, 30:90] = True
    apart = np.linspace(-3, 4, COUNT)
    number = np.arange(undecided.sum())
    known = np.broadcast_to(number % 1000, (COUNT, KNOWN, len(number))).astype(np.float16)
    about = np.broadcast_to(number // 1000, (ABOUT, len(number))).astype(np.float16)
    inverse = (true + apart[:, None]).reshape(COUNT, *sky.shape)
    one = Candidates(inverse, known, about, undecided, ~undecided, np.zeros(inverse.shape, bool), way)
    found = choice_data._of_view(one, batch, index, 4, np.random.default_rng(0))
    assert found.error.shape == (COUNT, PIXELS)
    assert found.error == pytest.approx(np.broadcast_to(apart[:, None], found.error.shape), abs=1e-4)  # of float32
    taken = found.about[0].astype(int) * 1000 + found.known[0, 0].astype(int)
    assert (np.diff(taken) > 0).all()
    assert sky[undecided][taken].any()
    assert (found.scene == 4).all()


def test_scenes_of_the_figures_teach_nothing() -> None:
    samples = made_up(4_000, 5)
    spoiled = samples._replace(error=np.where(held_out(samples), 5.0, samples.error).astype(np.float32))
    networks = [choice.trained(each, 1, 20).exported() for each in (samples, spoiled)]
    assert all((value == getattr(networks[1], name)).all() for name, value in vars(networks[0]).items())
    assert choice.figures(networks[0], spoiled)["best"][1] == 0
    assert held_out(samples).mean() == pytest.approx(1 / 8)


def test_a_loss_that_is_not_finite_is_refused_and_nothing_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    samples = made_up(50, 3)
    samples.about[:] = np.inf  # beyond float16
    monkeypatch.setattr(choice, "_generated", lambda *_: iter([samples]))
    assert choice.main([str(tmp_path / "out.npz"), "--steps", "3", "--quiet"]) == 1
    assert capsys.readouterr().err == "refused: step 1: the loss is nan, need a finite one: take another --seed\n"
    assert not list(tmp_path.iterdir())


def test_the_command_writes_the_network_and_its_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def generated(seed: int, scenes: int, processes: int) -> Iterator[Samples | None]:
        assert (seed, scenes, processes) == (4, 16, 2)
        yield None
        yield made_up(2_000, 3)

    monkeypatch.setattr(choice, "_generated", generated)
    out = tmp_path / "choice.npz"
    arguments = ["--scenes", "16", "--seed", "4", "--processes", "2", "--steps", "20", "--quiet"]
    assert choice.main([str(out), *arguments]) == 0
    told = capsys.readouterr().out
    assert told.startswith(f"{out}: 2000 pixels of 1 scenes, every 8th for these figures\n")
    assert [line.split(" cost ")[0].strip() for line in told.splitlines()[1:]] == ["as it is", "preferred", "best"]
    assert len(ChoiceNetwork.load(out).prior) == COUNT
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize(
    ("name", "reason"),
    [("missing/choice.npz", "missing is not a folder (make it first)"), ("folder", "is a folder, need a file")],
)
def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    name: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(choice, "_generated", lambda *_: pytest.fail("worked"))
    (tmp_path / "folder").mkdir()
    assert choice.main([str(tmp_path / name), "--quiet"]) == 1
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        ([None, None], "0 of 16 scenes have a choice, none of those for training"),
        ([7], "1 of 16 scenes have a choice, none of those for training"),
        ([1, None, 2], "2 of 16 scenes have a choice, none of those for the figures"),
        (KeyboardInterrupt, "stopped; nothing is kept"),
        (BrokenProcessPool, "ended, by lack of memory or"),
    ],
)
def test_without_scenes_nothing_is_written(
    parts: list[int | None] | type[BaseException],
    reason: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def generated(*_: int) -> Iterator[Samples | None]:
        if isinstance(parts, type):
            raise parts
        for part in parts:
            yield None if part is None else made_up(50, part)._replace(scene=np.full(50, part))

    monkeypatch.setattr(choice, "_generated", generated)
    code = choice.main([str(tmp_path / "out.npz"), "--scenes", "16", "--quiet"])
    assert code == (130 if parts is KeyboardInterrupt else 1)
    assert reason in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_the_weights_that_there_were(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(file: IO[bytes], **_: np.ndarray) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    out = tmp_path / "choice.npz"
    out.write_bytes(b"before")
    monkeypatch.setattr(choice, "_generated", lambda *_: iter([made_up(2_000, 3)]))
    monkeypatch.setattr(np, "savez", full)
    assert choice.main([str(out), "--steps", "1", "--quiet"]) == 1
    assert f"No space left on device: '{out}'" in capsys.readouterr().err
    assert out.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [out]
