"""Model files and their external weights: which belong together, and what a failed write leaves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import onnx
import pytest
from little_models import product

from gapmes.export.model_file import data_files, remove_model, write_model
from gapmes.service.process.disk import replacing


@pytest.fixture(autouse=True)
def _weights_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gapmes.export.model_file.EXTERNAL_BYTES", 1000)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("other", ["base", "base.onnx.0123456789ab"])
def test_the_weights_of_a_neighbour_stay(other: str, tmp_path: Path) -> None:
    write_model(product(1), tmp_path / "base.onnx")
    before = names(tmp_path)
    write_model(product(2), tmp_path / other)
    remove_model(tmp_path / other)
    assert names(tmp_path) == before
    onnx.load(tmp_path / "base.onnx")


@pytest.mark.parametrize("name", ["base[1].onnx", "a*b.onnx", "what?.onnx"])
def test_a_name_is_no_pattern(name: str, tmp_path: Path) -> None:
    for seed in (1, 2):
        write_model(product(seed), tmp_path / name)
        assert len(data_files(tmp_path / name)) == 1
        assert len(names(tmp_path)) == 2
    remove_model(tmp_path / name)
    assert names(tmp_path) == set()


def test_where_nothing_is_there_is_nothing_to_remove(tmp_path: Path) -> None:
    assert data_files(tmp_path / "none" / "a.onnx") == []
    remove_model(tmp_path / "none" / "a.onnx")


def test_a_write_that_fails_leaves_nothing_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "a.onnx").mkdir()
    with pytest.raises(IsADirectoryError):
        write_model(product(1), tmp_path / "a.onnx")
    assert names(tmp_path) == {"a.onnx"}


@pytest.mark.parametrize("late", [False, True])
def test_an_interrupt_leaves_a_graph_with_its_weights(
    late: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Just before the graph is replaced, and just after."""

    @contextmanager
    def interrupted(path: Path) -> Iterator[Path]:
        with replacing(path) as part:
            yield part
            if not late:
                raise KeyboardInterrupt
        raise KeyboardInterrupt

    write_model(product(1), tmp_path / "a.onnx")
    before = names(tmp_path)
    monkeypatch.setattr("gapmes.export.model_file.replacing", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_model(product(2), tmp_path / "a.onnx")
    assert late or names(tmp_path) == before
    (weights,) = onnx.load(tmp_path / "a.onnx").graph.initializer
    assert weights.raw_data == product(2 if late else 1).graph.initializer[0].raw_data


def test_behind_a_link_graph_and_weights_lie_together(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    link = tmp_path / "served.onnx"
    link.symlink_to(tmp_path / "real" / "net.onnx")
    write_model(product(1), link)
    assert link.is_symlink()
    assert len(data_files(link.resolve())) == 1
    assert names(tmp_path) == {"real", "served.onnx"}
    onnx.load(link.resolve())
