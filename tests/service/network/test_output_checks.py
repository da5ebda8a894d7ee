"""Outputs of a graph that is not what it says: refused by name, for their types, ranks and what they number."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from standin_model import COLUMNS, HEIGHT, ROWS, WIDTH

from gapmes.service.document import MAPPED, routing_summary
from gapmes.service.errors import ModelError
from gapmes.service.network.contract import OPTIONAL_OUTPUTS, REQUIRED_OUTPUTS
from gapmes.service.network.engine import Engine

OUTPUTS = REQUIRED_OUTPUTS + OPTIONAL_OUTPUTS
FLOATS = [name for name in OUTPUTS if name != "expert_index"]
Change = Callable[[NDArray], Any]


def run_with(engine: Engine, monkeypatch: pytest.MonkeyPatch, name: str, change: Change) -> None:
    """Run the network on two views, and change one of its outputs."""
    real = engine._session.run

    def run(names: list[str], feed: dict[str, NDArray]) -> list[Any]:
        return [change(value) if each == name else value for each, value in zip(names, real(names, feed), strict=True)]

    monkeypatch.setattr(engine._session, "run", run)
    poses = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    poses[1, 0, 3] = 0.1
    engine.run(
        np.full((2, 3, HEIGHT, WIDTH), 0.5, np.float32),
        np.tile(np.array([[1, 0, 0.5], [0, 1.3, 0.5], [0, 0, 1]], np.float32), (2, 1, 1)),
        poses,
        np.array([1, 9], np.float32),
        np.ones((2, ROWS * COLUMNS), bool),
    )


@pytest.mark.parametrize("type_", ["float64", "float16", "int64", "bool", "<U32"])
@pytest.mark.parametrize("name", FLOATS)
def test_another_type_than_float32_is_refused(
    engine: Engine, monkeypatch: pytest.MonkeyPatch, name: str, type_: str
) -> None:
    with pytest.raises(
        ModelError, match=rf"output is {np.dtype(type_).kind if type_ == 'str' else type_}|<U"
    ) as caught:
        run_with(engine, monkeypatch, name, lambda value: value.astype(type_))
    assert "need float32" in str(caught.value)
    assert caught.value.field == name


@pytest.mark.parametrize("type_", ["float32", "int32", "uint64"])
def test_experts_are_numbered_by_int64(engine: Engine, monkeypatch: pytest.MonkeyPatch, type_: str) -> None:
    with pytest.raises(ModelError, match=rf"output is {type_}, need int64") as caught:
        run_with(engine, monkeypatch, "expert_index", lambda value: value.astype(type_))
    assert caught.value.field == "expert_index"


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_single_number_and_a_sequence_are_no_output(
    engine: Engine, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    with pytest.raises(ModelError, match=r"output is \(\), need|\(0, 3\)|\(0,\)") as caught:
        run_with(engine, monkeypatch, name, lambda value: value.flat[0])
    assert caught.value.field == name
    monkeypatch.undo()
    with pytest.raises(ModelError, match="output is list, need") as caught:
        run_with(engine, monkeypatch, name, list)
    assert caught.value.field == name


@pytest.mark.parametrize(("stated", "least"), [({}, 128), ({"experts": 5}, 5)])
def test_an_expert_that_the_network_does_not_have_is_refused(
    engine: Engine, monkeypatch: pytest.MonkeyPatch, stated: dict[str, int], least: int
) -> None:
    monkeypatch.setattr(engine, "info", replace(engine.info, config=stated))
    run_with(engine, monkeypatch, "expert_index", lambda value: np.full_like(value, least - 1))
    for number in (-1, least, 10**12):
        monkeypatch.undo()
        monkeypatch.setattr(engine, "info", replace(engine.info, config=stated))
        with pytest.raises(ModelError, match=rf"numbers are not from 0 to {least - 1}, first at \[0, 0, 0\]") as caught:
            run_with(engine, monkeypatch, "expert_index", lambda value, number=number: np.full_like(value, number))
        assert caught.value.field == "expert_index"


@pytest.mark.parametrize("name", ["expert_weight", "task_weight"])
@pytest.mark.parametrize("value", [-1e-30, 1.01])
def test_weights_are_shares(engine: Engine, monkeypatch: pytest.MonkeyPatch, name: str, value: float) -> None:
    with pytest.raises(ModelError, match=r"numbers are not in \[0, 1\]") as caught:
        run_with(engine, monkeypatch, name, lambda found: np.full_like(found, value))
    assert caught.value.field == name


@pytest.mark.parametrize("experts", [MAPPED, MAPPED + 1])
def test_more_experts_than_digits_have_no_map(experts: int) -> None:
    """A longer number would move all patches behind it."""
    index = np.zeros((1, 6, 1), np.int64)
    index[0, 4, 0] = experts - 1
    found = routing_summary({"expert_index": index, "expert_weight": np.ones((1, 6, 1), np.float32)}, [0], 2)
    assert found["patches_per_expert"] == {str(k): {0: 5, experts - 1: 1}.get(k, 0) for k in range(experts)}
    assert json.loads(json.dumps(found)).get("maps") == ({"experts": ["0000Z0"]} if experts <= MAPPED else None)
