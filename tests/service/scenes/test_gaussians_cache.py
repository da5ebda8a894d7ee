"""The cache of decoded Gaussians: bounded in bytes, and never of a file that another has replaced."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
from store_folder import document, gaussians

from gapmes.service.errors import FormatError
from gapmes.service.formats.ply import ply_bytes
from gapmes.service.gaussians import Gaussians
from gapmes.service.scenes import store as store_module
from gapmes.service.scenes.gaussians_cache import GaussiansCache, size_of
from gapmes.service.scenes.store import SceneStore

A = "a" * 32
PLY = ply_bytes(gaussians())
ONE = size_of(gaussians(10))


def test_it_is_bounded_in_bytes_and_forgets_the_oldest() -> None:
    cache = GaussiansCache(2 * ONE)
    loads = []

    def load(name: str, count: int = 10) -> Gaussians:
        def loader() -> Gaussians:
            loads.append(name)
            return gaussians(count)

        return cache.get(name, 1, loader)

    load("a"), load("b"), load("a"), load("c")  # b was used longest ago
    assert loads == ["a", "b", "c"]
    assert cache.bytes == 2 * ONE
    load("a")
    load("b")
    assert loads == ["a", "b", "c", "b"]
    load("huge", 600)  # never fits: returned, not kept, and nobody is thrown out for it
    load("a")
    assert loads == ["a", "b", "c", "b", "huge"]
    cache.drop("a"), cache.drop("a")
    assert cache.bytes == ONE


def test_what_two_load_at_once_counts_once() -> None:
    cache = GaussiansCache(10 * ONE)
    cache.get("a", 1, lambda: cache.get("a", 1, lambda: gaussians(10)))
    assert cache.bytes == ONE
    cache.drop("a")
    assert cache.bytes == 0


def test_another_version_takes_the_place_of_one() -> None:
    cache = GaussiansCache(10 * ONE)
    first, second = (cache.get("a", version, lambda: gaussians(10)) for version in (1, 2))
    assert second is not first
    assert cache.get("a", 2, pytest.fail) is second
    assert cache.bytes == ONE


def test_the_store_reads_a_file_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = SceneStore(tmp_path)
    store.put(A, PLY, document(A))
    first = store.gaussians(A)
    monkeypatch.setattr(store_module, "inspect_ply", None)
    assert store.gaussians(A) is first


@pytest.mark.parametrize("begin", [len(PLY) - 60, 0], ids=["Gaussians", "header"])
def test_a_damaged_scene_that_another_process_made_anew_is_read_anew(tmp_path: Path, begin: int) -> None:
    one, two = SceneStore(tmp_path), SceneStore(tmp_path)
    one.put(A, PLY, document(A))
    (tmp_path / A / "scene.ply").write_bytes(PLY[:begin] + bytes(60) + PLY[begin + 60 :])
    if begin:
        assert not np.array_equal(two.gaussians(A).means, gaussians().means.astype(np.float32))
    else:
        with pytest.raises(FormatError):
            two.gaussians(A)
    one.delete(A)
    one.put(A, PLY, document(A))
    np.testing.assert_array_equal(two.gaussians(A).means, one.gaussians(A).means)
    np.testing.assert_allclose(two.gaussians(A).means, gaussians().means, rtol=1e-6)


def test_it_survives_many_threads() -> None:
    cache = GaussiansCache(3 * ONE)

    def use(seed: int) -> None:
        for key in np.random.default_rng(seed).integers(0, 8, 300):
            assert len(cache.get(str(key), 1, lambda: gaussians(10))) == 10
            assert 0 <= cache.bytes <= 3 * ONE
            if key == 0:
                cache.drop("1")

    threads = [threading.Thread(target=use, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert cache.bytes in (0, ONE, 2 * ONE, 3 * ONE)
