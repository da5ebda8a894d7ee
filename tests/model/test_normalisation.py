"""Group and instance normalisation in exported graphs: equal to torch, and accurate on nearly constant planes."""

from __future__ import annotations

import numpy as np
import onnxruntime
import pytest
import torch

from gapmes.export.fold import folded
from gapmes.model.normalisation import GroupNorm, InstanceNorm


def exported(module: torch.nn.Module, x: torch.Tensor) -> np.ndarray:
    import onnx_ir as ir

    program = torch.onnx.export(module.eval(), (x,), dynamo=True, opset_version=20, optimize=False, verbose=False)
    assert program is not None
    model = ir.to_proto(folded(program.model))
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(None, {session.get_inputs()[0].name: x.numpy()})[0]


def reference(module: torch.nn.Module, x: torch.Tensor) -> np.ndarray:
    with torch.no_grad():
        return module.double()(x.double()).numpy()


def worst(module: torch.nn.Module, x: torch.Tensor) -> float:
    found = exported(module, x)
    expected = reference(module, x)
    return float(np.abs(found - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("module", [GroupNorm(8, 48), InstanceNorm(48)], ids=["group", "instance"])
@pytest.mark.filterwarnings("ignore")
def test_nearly_constant_planes_stay_exact(module: torch.nn.Module) -> None:
    """What an image of one colour becomes behind a padded convolution: one value, and another along two borders."""
    torch.manual_seed(0)
    x = torch.randn(2, 48, 1, 1).expand(2, 48, 128, 128).contiguous()
    x[:, :, 0] *= 0.7
    x[..., -1] *= 1.2
    # measured 1.6e-7 and 2.7e-6; by onnxruntime's own operator 5.9e-5 and 1.1e-4
    assert worst(module, x) < 1e-5


@pytest.mark.parametrize("shape", [(2, 16, 7, 5), (3, 16, 40)])
@pytest.mark.filterwarnings("ignore")
def test_weights_and_any_number_of_axes(shape: tuple[int, ...]) -> None:
    torch.manual_seed(1)
    module = GroupNorm(4, 16)
    with torch.no_grad():
        module.weight.normal_()
        module.bias.normal_()
    assert worst(module, torch.randn(shape)) < 1e-6  # measured 1.1e-7 and 1.4e-7
