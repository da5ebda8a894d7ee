"""The choice among candidates: its torch twin, what it learns from, that it learns, and the command."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from gapmes.model.training import choice
from gapmes.model.training.choice_data import PIXELS, SIZE, Samples, scene_samples
from gapmes.model.training.scenes import SceneSampler
from gapmes.service import Reconstructor
from gapmes.service.choice.candidates import ABOUT, COUNT, KNOWN
from gapmes.service.choice.network import ChoiceNetwork


def made_up(count: int, seed: int) -> Samples:
    """The right candidate is the one whose first number is largest; 40 scenes."""
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
    networks = [choice.trained(samples, 7, 300).exported() for _ in range(2)]
    assert all((value == getattr(networks[1], name)).all() for name, value in vars(networks[0]).items())
    found = choice.figures(networks[0], samples)
    assert found["as it is"][1] < 0.2
    assert found["preferred"][1] > 0.9  # found: 0.98
    assert found["best"] == pytest.approx((0.1 / 1.6, 1.0), rel=1e-4)


def test_samples_of_a_scene_are_open_pixels_and_how_far_off_their_candidates_are() -> None:
    number = 2
    reconstructor = Reconstructor(None, threads=1)
    samples = scene_samples(reconstructor, 3, number)
    again = scene_samples(reconstructor, 3, number)
    assert samples is not None
    assert again is not None
    assert all((a == b).all() for a, b in zip(samples, again, strict=True))
    assert 0 < samples.error.shape[1] <= 2 * PIXELS
    assert samples.known.shape[:2] == (COUNT, KNOWN)
    assert len(samples.about) == ABOUT
    assert (samples.scene == number).all()
    # what the first two numbers and the third and fourth say of two candidates' distance, the errors say as well
    apart = samples.error[1] - samples.error[0]
    assert np.tanh(apart / 32) == pytest.approx(samples.known[1, 1].astype(float), abs=2e-3)
    assert np.median(np.abs(samples.error).min(axis=0)) < np.median(np.abs(samples.error[0]))


def test_background_is_infinitely_far() -> None:
    """In a scene with a sky no candidate of a pixel that shows it lies beyond: all errors are parallaxes, 0 or more."""
    reconstructor = Reconstructor(None, threads=1)
    for number in range(30):
        batch = SceneSampler(5, "train", first=number).batch(
            1, 2, 1, SIZE, baseline=(0.08, 0.8), field_of_view=(30.0, 80.0), close_share=0.4
        )
        if batch.background[0, :2].mean() > 0.3:
            samples = scene_samples(reconstructor, 5, number)
            assert samples is not None
            assert ((samples.error >= -1e-6).all(axis=0)).mean() > 0.1
            return
    pytest.fail("no scene with a sky")


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
    assert choice.main([str(tmp_path / "missing" / "choice.npz"), *arguments]) == 1
    assert "cannot be written" in capsys.readouterr().err
