"""The exported graph: symbolic views, metadata, sparse experts, and equality with torch at every view count."""

from __future__ import annotations

import json

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from gapmes.export.build import export_graph
from gapmes.export.cases import Case
from gapmes.export.gate_settings import gate_values, with_gates
from gapmes.export.graph import evaluated
from gapmes.export.metadata import OPSET
from gapmes.export.samples import FLAT, UNDETERMINED, hostile_scenes, random_scene
from gapmes.export.tolerance import TOLERANCES
from gapmes.export.verification import verify
from gapmes.model.config import preset
from gapmes.model.network import GaPMeS
from gapmes.model.weights_file import file_sha256
from gapmes.service.cameras.view_checks import MAX_VIEWS, MIN_VIEWS
from gapmes.service.network.contract import INPUTS, OPTIONAL_OUTPUTS, REQUIRED_OUTPUTS
from gapmes.service.shipped import shipped_model

SIZE, PATCHES = 64, 16


def feed(inputs) -> dict[str, np.ndarray]:
    return {name: value.numpy() for name, value in zip(INPUTS, inputs.tensors(), strict=True)}


def test_inputs_and_outputs_are_those_of_the_contract(small_graph: onnx.ModelProto) -> None:
    assert tuple(i.name for i in small_graph.graph.input) == INPUTS
    assert tuple(o.name for o in small_graph.graph.output) == REQUIRED_OUTPUTS + OPTIONAL_OUTPUTS
    assert {o.domain: o.version for o in small_graph.opset_import}[""] == OPSET
    shape = small_graph.graph.input[0].type.tensor_type.shape.dim
    assert shape[0].dim_param
    assert [d.dim_value for d in shape[1:]] == [3, SIZE, SIZE]


def test_the_shipped_file_is_built_of_what_the_exporter_makes_today(small_graph: onnx.ModelProto) -> None:
    """The size differs, and with it the numbers of pieces; kinds of nodes and weights do not."""
    shipped = onnx.load(shipped_model())
    assert {n.op_type for n in shipped.graph.node} == {n.op_type for n in small_graph.graph.node}
    ours, theirs = (
        {
            i.name: i.raw_data
            for i in model.graph.initializer
            if i.name.startswith("network.") and "lifted" not in i.name and not i.name.endswith("embeddings.constant")
        }
        for model in (small_graph, shipped)
    )  # position embeddings are resampled to the size
    assert ours.keys() == theirs.keys()
    # to show how the bytes differ would take minutes
    assert not [name for name in ours if ours[name] != theirs[name]]
    assert len(theirs) > 100


@pytest.mark.parametrize(("experts", "chosen"), [(1, [0]), (2, [0, 1]), (3, [1, 2]), (6, [1, 5])])
def test_two_experts_are_two_wherever_there_are_so_many(experts: int, chosen: list[int]) -> None:
    network = GaPMeS(preset("tiny", experts=experts, top_k=1))
    bias = gate_values(network, "two experts")["mixture.gates.expert_gate.bias"]
    assert torch.nonzero(bias).flatten().tolist() == chosen


def test_a_pair_of_views_that_shares_nothing_leaves_an_empty_batch_that_runs(small_graph: onnx.ModelProto) -> None:
    """The cameras look away from each other: no pair is compared on any plane."""
    inputs = random_scene(2, SIZE, SIZE, seed=1)
    inputs.world_from_cam[1, :3, :3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0]))
    session = onnxruntime.InferenceSession(small_graph.SerializeToString(), providers=["CPUExecutionProvider"])
    assert all(np.isfinite(value).all() for value in session.run(None, feed(inputs)))


def test_metadata_says_what_the_file_is(small_graph: onnx.ModelProto, network: GaPMeS, checkpoint) -> None:
    found = {p.key: p.value for p in small_graph.metadata_props}
    assert found["gapmes.preset"] == "tiny"
    assert found["gapmes.weights_sha256"] == file_sha256(checkpoint)
    assert found["gapmes.config"] == network.config.to_json()
    assert (found["gapmes.height"], found["gapmes.width"], found["gapmes.patch_px"]) == ("64", "64", "16")
    assert json.loads(found["gapmes.views"]) == [MIN_VIEWS, MAX_VIEWS]
    assert all(key.startswith("gapmes.") for key in found)


def test_no_path_of_the_exporting_machine_is_left_in_the_file(small_graph: onnx.ModelProto) -> None:
    graph = onnx.ModelProto()
    graph.CopyFrom(small_graph)
    for tensor in graph.graph.initializer:
        tensor.ClearField("raw_data")  # numbers: two of five files of this size have ".py" by chance
    text = graph.SerializeToString()
    assert b"site-packages" not in text
    assert b".py" not in text


@pytest.mark.case("B1")
@pytest.mark.parametrize("views", [2, 3, 4, 5, 6])
def test_every_view_count_agrees_with_torch(small_graph: onnx.ModelProto, network: GaPMeS, views: int) -> None:
    """Outputs of the whole graph are compared with float32 torch, not single stages with float64."""
    cases = [Case("random", "as trained", random_scene(views, SIZE, SIZE, seed=views))]
    (result,) = verify(small_graph, network, cases, TOLERANCES["fp32"])
    assert result.failures == []
    assert result.routes is not None
    assert result.routes.patches == views * PATCHES


@pytest.mark.case("B1", "R1")
@pytest.mark.parametrize("gates", ["all tied", "one expert", "two experts"])
def test_gate_settings_agree_with_torch(small_graph: onnx.ModelProto, network: GaPMeS, gates: str) -> None:
    before = {k: v.clone() for k, v in network.state_dict().items()}
    (result,) = verify(
        small_graph, network, [Case("random", gates, random_scene(3, SIZE, SIZE, seed=1))], TOLERANCES["fp32"]
    )
    assert result.failures == []
    assert all(torch.equal(before[k], v) for k, v in network.state_dict().items())


@pytest.mark.case("B1", "P2", "P8")
def test_hostile_scenes_stay_finite_and_agree(small_graph: onnx.ModelProto, network: GaPMeS) -> None:
    scenes = hostile_scenes(2, SIZE, SIZE)
    cases = [
        Case(name, "as trained", inputs, flat=name in FLAT, undetermined=name in UNDETERMINED)
        for name, inputs in scenes.items()
    ]
    for result in verify(small_graph, network, cases, TOLERANCES["fp32"]):
        assert result.failures == [], result.name
        assert all(d.finite for d in result.outputs.values())


def expert_rows(model: onnx.ModelProto, inputs) -> list[int]:
    """Batch sizes of the first convolution of every expert in one run: 3 streams times its patches."""
    watched = onnx.ModelProto()
    watched.CopyFrom(model)
    names = []
    for number in range(6):
        weight = f"network.mixture.experts.experts.{number}.layers.0.weight"
        (node,) = [n for n in watched.graph.node if weight in n.input]
        names.append(node.output[0])
        watched.graph.output.append(onnx.helper.make_empty_tensor_value_info(node.output[0]))
    session = onnxruntime.InferenceSession(watched.SerializeToString(), providers=["CPUExecutionProvider"])
    return [value.shape[0] for value in session.run(names, feed(inputs))]


def weights_missing_or_left(network: GaPMeS, inputs, weight: np.ndarray) -> tuple[int, int]:
    """How many choices weigh nothing where float64 has a float32 for their weight, and how many weigh something where
    it has none. Subnormal numbers may go either way, since an exponential may flush them; weights as small as these
    differ by up to 5e-5 of themselves (measured)."""
    exact = evaluated(network, inputs, torch.float64)["expert_weight"]
    kinds, rounding = np.finfo(np.float32), 1e-3
    missing = (weight == 0) & (exact > kinds.tiny * (1 + rounding))
    left = (weight != 0) & (exact < kinds.smallest_subnormal / 2 * (1 - rounding))
    return int(missing.sum()), int(left.sum())


@pytest.mark.case("S2")
@pytest.mark.parametrize("gates", ["as trained", "all tied", "one expert", "two experts"])
def test_each_expert_runs_on_just_the_patches_that_chose_it(
    small_graph: onnx.ModelProto, network: GaPMeS, gates: str
) -> None:
    values = gate_values(network, gates)
    model = with_gates(small_graph, values)
    network.load_state_dict(values, strict=False)
    inputs = random_scene(3, SIZE, SIZE, seed=4)
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    index, weight = session.run(["expert_index", "expert_weight"], feed(inputs))
    chosen = np.bincount(index[weight != 0], minlength=6)
    # a second choice whose weight underflows to 0 needs no run either
    assert weights_missing_or_left(network, inputs, weight) == (0, 0)
    assert (weight.max(axis=-1) > 0).all()
    assert expert_rows(model, inputs) == (3 * chosen).tolist()
    if gates != "as trained":
        assert chosen.sum() == 3 * PATCHES * (1 if gates == "one expert" else 2)
    if gates == "one expert":
        assert np.flatnonzero(chosen).tolist() == [5]
    if gates == "two experts":
        assert sorted(np.flatnonzero(chosen)) == [1, 5]


@pytest.mark.case("S2")
def test_left_out_patches_run_through_no_expert(small_graph: onnx.ModelProto, network: GaPMeS) -> None:
    inputs = hostile_scenes(3, SIZE, SIZE)
    assert sum(expert_rows(small_graph, inputs["all masked"])) == 0
    session = onnxruntime.InferenceSession(small_graph.SerializeToString(), providers=["CPUExecutionProvider"])
    (weight,) = session.run(["expert_weight"], feed(inputs["half masked"]))
    assert sum(expert_rows(small_graph, inputs["half masked"])) == 3 * (weight != 0).sum()
    assert ((weight != 0).any(axis=-1).sum()) == 3 * PATCHES // 2  # the patches that are not masked
    assert weights_missing_or_left(network, inputs["half masked"], weight) == (0, 0)


@pytest.mark.case("P9")
def test_a_size_that_does_not_fit_is_refused(network: GaPMeS) -> None:
    with pytest.raises(ValueError, match="height is 100 px, need a multiple of 16"):
        export_graph(network, 100, 64)
