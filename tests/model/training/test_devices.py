"""A training step on another device than the CPU: no operation mixes tensors of both, forward or backward."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from gapmes.model.config import preset
from gapmes.model.network import GaPMeS
from gapmes.model.training import rendering
from gapmes.model.training import step as training_step
from gapmes.model.training.recipe import Recipe
from gapmes.model.training.scenes import SceneSampler

MOVES = (torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default)


class OneDevice(TorchDispatchMode):
    """Fails where tensors of two devices meet. Scalars of the CPU may meet any device."""

    def __torch_dispatch__(
        self,
        func: Callable[..., object],
        types: object,
        args: tuple[object, ...] = (),
        kwargs: dict[str, object] | None = None,
    ) -> object:
        tensors = [leaf for leaf in tree_leaves((args, kwargs or {})) if isinstance(leaf, Tensor) and leaf.dim() > 0]
        found = {tensor.device.type for tensor in tensors}
        if func not in MOVES and len(found) > 1:
            raise AssertionError(f"{func} mixes {sorted(found)}")
        return func(*args, **(kwargs or {}))


def test_a_mixture_is_found() -> None:
    with OneDevice(), pytest.raises(AssertionError, match=r"mixes \['cpu', 'meta'\]"):
        torch.zeros(2, device="meta") + torch.zeros(2)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("tiny", {}),
        ("tiny", {"sh_degree": 2}),
        ("tiny", {"without_tasks": True}),
        ("tiny", {"without_experts": True}),
        ("tiny", {"without_depth": True}),
        ("small", {}),
    ],
)
def test_a_step_stays_on_its_device(name: str, changes: dict[str, object], monkeypatch: pytest.MonkeyPatch) -> None:
    """The meta device, which has shapes and no numbers, stands for a graphics card; the splatter, which computes on the
    processor whatever it is given, is left out."""

    def shape_of_pictures(
        means: Tensor,
        factors: Tensor,
        opacities: Tensor,
        colours: Tensor,
        poses: Tensor,
        k: Tensor,
        h: int,
        w: int,
        **_: object,
    ) -> tuple[Tensor, Tensor]:
        given = (means, factors, opacities, colours, poses, k)
        assert {tensor.device.type for tensor in given} == {"meta"}
        total = means.sum() + factors.sum() + opacities.sum() + colours.sum()
        return total.expand(*poses.shape[:2], 3, h, w) * 1, total.expand(*poses.shape[:2], 1, h, w) * 1

    monkeypatch.setattr(rendering, "splat", shape_of_pictures)
    monkeypatch.setattr(Tensor, "__float__", lambda _: 0.5)  # figures of the log, which need numbers
    model = GaPMeS(preset(name, **changes)).to("meta").train()
    model.keep_all()  # which experts work on a patch is a matter of numbers
    batch = training_step.to_tensors(SceneSampler(5, "train").batch(2, 3, 2, 64), zoomed=False).to("meta")
    with OneDevice():
        loss, parts = training_step.training_loss(model, batch, Recipe(), 3)
        loss.backward()
    assert loss.device.type == "meta"
    assert {"mse", "depth"} <= set(parts)
    assert all(p.grad is None or p.grad.device.type == "meta" for p in model.parameters())
