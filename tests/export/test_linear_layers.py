"""Linear layers as deployed: only rounding differs in float64, no length is slow, and the modules are restored
afterwards."""

from __future__ import annotations

import onnx
import pytest
import torch
from full_networks import miniature
from torch import nn

from gapmes.export.linear_layers import SLOW_LENGTH, ZEROS, deployed_linear_layers, lengthened, scaled
from gapmes.model.config import VitConfig
from gapmes.model.depthsplat.transformer import MultiViewTransformer
from gapmes.model.vit import Vit

EXACT = 1e-13  # of float64; measured at most 1e-14


def scattered_scales(network: nn.Module) -> None:
    """LayerScales that are neither all equal nor all positive, as trained ones are."""
    for name, parameter in network.named_parameters():
        if "layer_scale" in name:
            nn.init.normal_(parameter)


def test_a_folded_scale_is_the_product_of_layer_and_scale() -> None:
    layer, scale = nn.Linear(7, 5).double(), torch.randn(5, dtype=torch.float64)
    x = torch.randn(3, 7, dtype=torch.float64)
    torch.testing.assert_close(scaled(layer, scale)(x), layer(x) * scale, rtol=EXACT, atol=EXACT)


@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize("hidden", [SLOW_LENGTH - 16, SLOW_LENGTH, 2 * SLOW_LENGTH])
def test_more_hidden_channels_change_nothing(hidden: int, bias: bool) -> None:
    first, last = nn.Linear(6, hidden, bias=bias).double(), nn.Linear(hidden, 4, bias=bias).double()
    longer_first, longer_last = lengthened(first, last)
    assert longer_first.out_features == longer_last.in_features == hidden + (0 if hidden % SLOW_LENGTH else ZEROS)
    x = torch.randn(3, 6, dtype=torch.float64)
    expected = last(nn.functional.gelu(first(x)))
    torch.testing.assert_close(longer_last(nn.functional.gelu(longer_first(x))), expected, rtol=EXACT, atol=EXACT)


def test_a_vit_computes_the_same_and_is_itself_again_afterwards() -> None:
    torch.manual_seed(0)
    vit = Vit(VitConfig(hidden=256, layers=2, heads=4, patch=14, image_size=56, mlp_ratio=4)).double().eval()
    scattered_scales(vit)
    before, modules = {k: v.clone() for k, v in vit.state_dict().items()}, list(vit.modules())
    pictures = torch.randn(2, 3, 56, 56, dtype=torch.float64)
    with torch.no_grad():
        expected = vit(pictures)
        with deployed_linear_layers(vit):
            assert vit.encoder.layer[0].mlp.fc1.out_features == SLOW_LENGTH + ZEROS
            deployed = vit(pictures)
    torch.testing.assert_close(deployed, expected, rtol=EXACT, atol=EXACT)
    assert list(vit.modules()) == modules
    after = vit.state_dict()
    assert before.keys() == after.keys()
    assert all(torch.equal(before[name], after[name]) for name in before)


def test_the_transformer_across_views_computes_the_same() -> None:
    torch.manual_seed(0)
    transformer = MultiViewTransformer(layers=2).double().eval()
    features, rows = torch.randn(2, 128, 8, 8, dtype=torch.float64), torch.tensor([1, 0])
    with torch.no_grad():
        expected = transformer(features, rows)
        with deployed_linear_layers(transformer):
            hidden = {m.out_features for m in transformer.modules() if isinstance(m, nn.Linear)}
            assert SLOW_LENGTH + ZEROS in hidden
            assert SLOW_LENGTH not in hidden
            deployed = transformer(features, rows)
    torch.testing.assert_close(deployed, expected, rtol=EXACT, atol=EXACT)


def test_layers_come_back_when_an_export_fails() -> None:
    vit = miniature().semantic.vit
    modules = list(vit.modules())
    with pytest.raises(RuntimeError, match="half way"), deployed_linear_layers(vit):
        raise RuntimeError("half way")
    assert list(vit.modules()) == modules


def test_a_graph_has_neither_a_mask_of_ones_nor_scales_of_their_own(miniature_graph: onnx.ModelProto) -> None:
    of_vits = [n for n in miniature_graph.graph.node if ".vit." in n.name or ".backbone." in n.name]
    attention = [n.op_type for n in of_vits if n.name.split("/")[0].endswith(".attention")]
    assert attention.count("Softmax") > 0
    assert "Add" not in attention
    assert not [n.name for n in of_vits if "layer_scale" in n.name]
