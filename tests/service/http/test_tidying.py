"""Periodic tidying of a running service: each part runs whether or not another fails."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from store_folder import document

from gapmes.service.http import runtime as runtime_module
from gapmes.service.http.runtime import Runtime
from gapmes.service.scenes.store import SceneStore
from gapmes.service.settings import Settings


def test_what_is_beyond_a_limit_goes_at_the_start(settings: Settings, tmp_path: Path) -> None:
    store = SceneStore(tmp_path)
    for number in range(3):
        scene_id = f"{number:032x}"
        store.put(scene_id, b"x" * 1000, document(scene_id))
    runtime = Runtime(settings.model_copy(update={"store": tmp_path, "store_bytes": 2700}))

    async def until_gone() -> None:
        task = asyncio.create_task(runtime._tidy())
        while store.totals()[0] == 3:
            await asyncio.sleep(0.001)
        task.cancel()

    asyncio.run(asyncio.wait_for(until_gone(), 30))  # the next round is later
    assert store.totals()[0] == 2


@pytest.mark.parametrize("broken", ["store", "jobs"])
def test_what_cannot_be_tidied_does_not_keep_the_rest_from_it(
    settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, broken: str
) -> None:
    runtime = Runtime(settings.model_copy(update={"store": tmp_path}))
    told: list[str] = []

    def tidy(part: str) -> None:
        told.append(part)
        if part == broken:
            raise OverflowError("a number that no clock shows")

    monkeypatch.setattr(runtime_module, "TIDY_S", 0.001)
    monkeypatch.setattr(runtime.store, "evict_old", lambda: tidy("store"))
    monkeypatch.setattr(runtime.jobs, "tidy", lambda: tidy("jobs"))

    async def for_two_rounds() -> None:
        task = asyncio.create_task(runtime._tidy())
        while len(told) < 4:
            await asyncio.sleep(0.001)
        task.cancel()

    asyncio.run(asyncio.wait_for(for_two_rounds(), 120))
    assert told[:4] == ["store", "jobs", "store", "jobs"]
    assert "a number that no clock shows" in caplog.text
