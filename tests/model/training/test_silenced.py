"""Silencing: silenced parts have no influence, the others are unchanged, and the command prints its table."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import torch
from random_lpips import random_weights
from rich.console import Console

from gapmes.model.checkpoint import load_checkpoint, save_checkpoint, shipped_checkpoint
from gapmes.model.config import preset
from gapmes.model.network import GaPMeS
from gapmes.model.streams import TaskMaps
from gapmes.model.training import silenced as module
from gapmes.model.training import study
from gapmes.model.training.ablation_runs import WIDE, scene_scores
from gapmes.model.training.ablation_table import Scores
from gapmes.model.training.lpips import Lpips
from gapmes.model.training.silenced import WHOLE, measure, parts, silenced, table
from gapmes.model.training.validation import validation_batches

STREAMS = ["depth stream", "texture stream", "semantic stream", "all streams"]
GATED = ["experts", "choice of experts", "task weights", "choice of task weights"]


def network(**changes: object) -> GaPMeS:
    torch.manual_seed(2)
    return GaPMeS(preset("tiny", **changes)).eval()


def mixed(model: GaPMeS, seed: int = 0, loud: str | None = None) -> TaskMaps:
    """What the mixture makes of random features of two images; `loud` names a stream that is given others."""
    generator = torch.Generator().manual_seed(seed)
    mixture = model.mixture
    streams = {
        name: torch.randn(2, mixture.align[name].in_channels, 8, 8, generator=generator)
        for name in mixture.config.streams
    }
    if loud is not None:
        streams[loud] = streams[loud].flip(-1)  # each image keeps its mean
    with torch.no_grad():
        return mixture(streams, torch.zeros(2, 1, 8, 8), torch.ones(8))


def same(a: TaskMaps, b: TaskMaps) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a.maps, b.maps, strict=True))


def near(a: TaskMaps, b: TaskMaps) -> bool:
    """Equal up to the rounding of a mean that is taken in another order."""
    return all(torch.allclose(x, y, atol=1e-5) for x, y in zip(a.maps, b.maps, strict=True))


def test_every_part_matters_and_comes_back() -> None:
    model = network()
    assert parts(model) == STREAMS + GATED
    before = mixed(model)
    for part in parts(model):
        with silenced(model, part):
            assert not same(mixed(model), before), part
        assert same(mixed(model), before), part


@pytest.mark.parametrize("name", ["depth", "texture", "semantic"])
def test_a_silent_stream_has_no_influence(name: str) -> None:
    model = network()
    assert not near(mixed(model), mixed(model, loud=name))
    with silenced(model, f"{name} stream"):
        assert near(mixed(model), mixed(model, loud=name))
        other = next(stream for stream in model.config.streams if stream != name)
        assert not near(mixed(model), mixed(model, loud=other))
    with silenced(model, "all streams"):
        for features in mixed(model).maps:
            assert torch.allclose(features, features[..., :4, :4].repeat(1, 1, 2, 2), atol=1e-5)


def test_silent_experts_and_tasks_are_those_of_a_network_that_never_had_them() -> None:
    """Against the same weights in networks built without the parts."""
    model = network()
    for part, changes in (("experts", {"without_experts": True}), ("task weights", {"without_tasks": True})):
        without = network(**changes)
        left = {name: value for name, value in model.state_dict().items() if name in without.state_dict()}
        without.load_state_dict(left)
        with silenced(model, part):
            assert same(mixed(model), mixed(without)), part


def test_the_choices_keep_what_is_not_chosen() -> None:
    """Shuffled experts bear the load that they bore; even task weights have the mean that they had."""
    model = network()
    before = mixed(model).routing
    with silenced(model, "choice of experts"):
        shuffled = mixed(model).routing
    assert not torch.equal(shuffled.expert_index, before.expert_index)
    pairs = [sorted(zip(r.expert_index.tolist(), r.expert_weight.tolist(), strict=True)) for r in (before, shuffled)]
    assert pairs[0] == pairs[1]
    assert torch.equal(shuffled.task_weight, before.task_weight)
    with silenced(model, "choice of task weights"):
        even = mixed(model).routing
    assert (even.task_weight == even.task_weight[0]).all()
    assert torch.allclose(even.task_weight[0], before.task_weight.mean(0))
    assert torch.equal(even.expert_weight, before.expert_weight)


def test_a_part_that_the_network_lacks_is_refused() -> None:
    assert parts(network(without_experts=True)) == STREAMS + GATED[2:]
    assert parts(network(without_tasks=True)) == STREAMS + GATED[:2]
    assert parts(network(without_depth=True)) == STREAMS[1:] + GATED
    with (
        pytest.raises(KeyError, match="'experts' is no part of this network, which has depth stream"),
        silenced(network(without_experts=True), "experts"),
    ):
        pass


def test_the_table_tells_the_whole_and_the_differences() -> None:
    def scores(psnr: list[float], lpips: list[float] | None) -> Scores:
        half = np.full(2, 0.5)
        return Scores(1, 0.0, np.array(psnr), half, half, half, None if lpips is None else np.array(lpips))

    text = table({WHOLE: scores([20, 22], [0.1, 0.3]), "experts": scores([19, 20], [0.2, 0.3])}, "caption")
    assert "| nothing | 21.00 | 0.5000 | 0.2000 | 0.5000 |" in text
    assert "| experts | -1.50 ± 0.50 | +0.0000 ± 0.0000 | +0.0500 ± 0.0500 | +0.0000 ± 0.0000 |" in text
    assert "LPIPS" not in table({WHOLE: scores([20, 22], None)}, "caption")


def test_the_command_measures_a_checkpoint_and_fills_its_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "default_weights", lambda: None)
    model, weights, page = network(without_experts=True), tmp_path / "w.safetensors", tmp_path / "page.md"
    save_checkpoint(weights, model)
    few = ["--weights", str(weights), "--scenes", "2", "--size", "32", "--page", str(page)]
    page.write_text("no markers")
    assert module.main(few) == 1
    assert "need one of each" in capsys.readouterr().err
    page.write_text("before\n<!-- silenced: begin -->\nold\n<!-- silenced: end -->\nafter\n")
    assert module.main(few) == 0
    printed = capsys.readouterr()
    assert page.read_text() == f"before\n<!-- silenced: begin -->\n{printed.out}<!-- silenced: end -->\nafter\n"
    assert "7 of 7  choice of task weights silenced" in printed.err
    assert [line.split("|")[1].strip() for line in printed.out.splitlines()[4:]] == [WHOLE, *parts(model)]
    assert module.main([*few[:4], "--size", "40"]) == 1
    assert "--size is 40, need a multiple of 16 for these weights" in capsys.readouterr().err
    assert module.main(["--weights", str(tmp_path / "none.safetensors")]) == 1
    assert "no such file" in capsys.readouterr().err


def test_an_interrupt_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "measure", interrupted)
    assert module.main([]) == 130
    assert capsys.readouterr().err == "stopped; nothing is kept\n"


def test_every_row_is_measured_with_its_part_silenced_and_the_first_with_none() -> None:
    model, console = load_checkpoint(shipped_checkpoint("tiny")), Console(file=io.StringIO())
    found = measure(model, 64, 1, Lpips(random_weights()), console)
    assert list(found) == [WHOLE, *parts(model)]
    assert all(scores.lpips.shape == (1,) for scores in found.values())
    batches = validation_batches(64, 1, WIDE)
    for part in parts(model):
        assert found[part].psnr.tolist() != found[WHOLE].psnr.tolist(), part
        with silenced(model, part):
            assert found[part].psnr.tolist() == scene_scores(model, batches, 0.0).psnr.tolist(), part
    assert measure(model, 64, 1, None, console)[WHOLE].psnr.tolist() == found[WHOLE].psnr.tolist()
