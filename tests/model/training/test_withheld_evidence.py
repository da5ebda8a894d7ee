"""Training steps without matching evidence: how often they occur, that no evidence remains, and which weights learn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from small_networks import scene, tiny

from gapmes.model import depth
from gapmes.model.config import preset
from gapmes.model.network import GaPMeS
from gapmes.model.training import loop
from gapmes.model.training.recipe import FINISH, Phase, Recipe
from gapmes.model.training.training_run import TrainingRun


@pytest.fixture(scope="module")
def network() -> GaPMeS:
    return tiny()


@pytest.fixture
def swept(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, ...]]:
    """Shapes of the pictures whose evidence was asked for, one after the other."""
    asked: list[tuple[int, ...]] = []
    real = depth.matching_evidence

    def counting(images: torch.Tensor, *args: object, **options: object) -> torch.Tensor:
        asked.append(tuple(images.shape))
        return real(images, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(depth, "matching_evidence", counting)
    return asked


def test_it_is_kept_back_less_and_less_and_never_at_the_end() -> None:
    recipe = Recipe()
    shares = [recipe.withheld_at(step) for step in range(recipe.steps)]
    end = round(recipe.withheld_until * recipe.steps)
    assert shares[0] == 1.0
    assert shares[: end + 1] == sorted(shares[: end + 1], reverse=True)
    assert shares[end // 2] == pytest.approx(0.5, abs=1e-3)
    assert set(shares[end:]) == {0.0}
    assert {FINISH.withheld_at(step) for step in range(FINISH.steps)} == {0.0}


@pytest.mark.parametrize(("until", "sweeps"), [(0.0, 3), (1e9, 0)])
def test_a_run_draws_its_steps(until: float, sweeps: int, swept: list[tuple[int, ...]], tmp_path: Path) -> None:
    phase = Phase(1.0, (32,), 1, (2,), (0.1, 0.4))
    recipe = replace(Recipe(), steps=3, phases=(phase,), withheld_until=until, zoom_share=0.0)
    loop.train(TrainingRun(preset("tiny"), recipe, tmp_path / "run", validate_every=100, validation_scenes=1))
    assert swept.count((2, 3, 16, 16)) == sweeps  # validation, at another size, always has it


def test_a_network_in_use_has_evidence_whatever_the_last_step_was(
    network: GaPMeS, swept: list[tuple[int, ...]]
) -> None:
    with torch.no_grad():
        before = network(*scene())
        network.depth.withheld = True
        after = network(*scene())
        network.depth.withheld = False
    assert len(swept) == 2
    assert torch.equal(before.gaussians.means, after.gaussians.means)


@pytest.mark.parametrize("withheld", [True, False])
def test_the_own_depth_learns_from_the_final_one_only_without_evidence(withheld: bool) -> None:
    network = tiny().train()
    network.depth.withheld = withheld
    estimate = network(*scene()).estimate
    (gradient,) = torch.autograd.grad(estimate.full.sum(), estimate.quarter, allow_unused=True)
    if withheld:  # the final depth is the first one moved: each of its pixels hangs on the first with a weight of 1
        assert float(gradient.sum()) == pytest.approx(estimate.full.numel(), rel=1e-4)
    else:
        assert gradient is None


def test_without_evidence_the_own_depth_is_where_refinement_begins(
    network: GaPMeS, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[torch.Tensor] = []
    real = depth.agreement_cues

    def seeing(inverse: torch.Tensor, *args: object) -> torch.Tensor:
        begun.append(inverse)
        return real(inverse, *args)  # type: ignore[arg-type]

    monkeypatch.setattr(depth, "agreement_cues", seeing)
    network.train()
    network.depth.withheld = True
    try:
        with torch.no_grad():
            estimate = network(*scene()).estimate
    finally:
        network.depth.withheld = False
        network.eval()
    torch.testing.assert_close(begun[0], depth.resize_to(estimate.quarter, begun[0]), atol=0, rtol=0)
