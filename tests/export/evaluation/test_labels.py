"""Labels of scenes and models: the shortest parts of their paths that are distinct, in tables and picture names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gapmes.export.evaluation.labels import file_stems, given_twice, shortest_names
from gapmes.export.evaluation.models import _labels
from gapmes.export.evaluation.plans import evaluation_plans
from gapmes.export.evaluation.scores import BASELINES, TRUE_DEPTH
from gapmes.export.size import Size
from gapmes.service.errors import InputError, ModelError


def test_names_are_as_long_as_they_need_be() -> None:
    assert shortest_names([]) == []
    assert shortest_names([Path("a/room"), Path("b/hall")]) == ["room", "hall"]
    assert shortest_names([Path("a/room"), Path("b/room"), Path("c/hall")]) == ["a/room", "b/room", "c/hall"]
    assert shortest_names([Path("a/x/room"), Path("b/x/room")]) == ["a/x/room", "b/x/room"]
    with pytest.raises(ValueError, match="the same path twice"):
        shortest_names([Path("room"), Path("./room")])


def test_the_folder_one_is_in_has_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "room").mkdir()
    monkeypatch.chdir(tmp_path / "room")
    assert shortest_names([Path()]) == ["room"]


def test_a_path_given_twice_is_found_behind_a_link(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    os.symlink(tmp_path / "room", tmp_path / "link")
    assert given_twice([tmp_path / "room", tmp_path / "hall"]) is None
    assert given_twice([tmp_path / "room", tmp_path / "hall", tmp_path / "link"]) == tmp_path / "link"
    with pytest.raises(InputError, match="room is given twice"):
        evaluation_plans([tmp_path / "room", tmp_path / "hall" / ".." / "room"], None, [], [], [])
    with pytest.raises(ModelError, match="link is given twice"):
        _labels([tmp_path / "room", tmp_path / "link"])


def test_a_number_of_inputs_or_a_size_given_twice_is_refused() -> None:
    with pytest.raises(InputError, match="inputs: 2 is given twice and would count so in the means"):
        evaluation_plans([], 1, [2, 3, 2], [], [])
    with pytest.raises(InputError, match="size: 64 is given twice and would count so in the means"):
        evaluation_plans([], 1, [], [Size.parse(text) for text in ("64", "64x80", "64x64")], [])


def test_models_are_named_by_their_stems_where_these_differ() -> None:
    assert _labels([Path("a/one.onnx"), Path("a/two.onnx")]) == ["one", "two"]
    assert _labels([Path("a/one.onnx"), Path("a/one.safetensors")]) == ["one.onnx", "one.safetensors"]
    assert _labels([Path("a/one.onnx"), Path("b/one.onnx")]) == ["a/one.onnx", "b/one.onnx"]


@pytest.mark.parametrize("name", [*BASELINES, TRUE_DEPTH])
def test_no_model_takes_the_row_of_a_baseline(name: str) -> None:
    assert _labels([Path(f"a/{name}.onnx")]) == [f"{name}.onnx"]
    assert _labels([Path(f"a/{name}"), Path("b/one.onnx")]) == [f"a/{name}", "b/one.onnx"]


def test_plans_name_scenes_of_the_same_last_name_by_more() -> None:
    plan = evaluation_plans([Path("a/room"), Path("b/room")], None, [2], [], [])[0]
    assert plan.folders == {"a/room": Path("a/room"), "b/room": Path("b/room")}


def test_no_two_pictures_have_one_name() -> None:
    names = ["a/room", "a room", "b/room", "a_room"]
    assert list(file_stems(names).values()) == ["a_room", "a_room_2", "b_room", "a_room_3"]
    names = ["generated 000", "generated_000", "generated_house"]
    assert list(file_stems(names).values()) == ["generated_000_2", "generated_000_3", "generated_house"]
