"""A scene that a job has just made stays until its client has seen that it exists."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from store_folder import document

from gapmes.service.errors import StorageFull
from gapmes.service.jobs.table import JobTable
from gapmes.service.scenes.scene_index import HANDOVER_S
from gapmes.service.scenes.store import SceneStore

ASKED, OTHER = "a" * 32, "b" * 32


def test_the_scene_of_a_job_is_not_evicted_before_anybody_could_see_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = SceneStore(tmp_path, max_bytes=400)
    table = JobTable(store.database, most=5, keep_s=100.0)
    table.submit("1", ASKED, "web")
    table.claim("me")
    store.put(ASKED, b"x" * 100, document(ASKED))
    ended = time.time()
    monkeypatch.setattr(time, "time", lambda: ended)
    soon = ended + 1.5  # several turns of those who ask whether it is there
    for step in (
        lambda: None,
        lambda: table.end("1", "me", "done"),
        lambda: monkeypatch.setattr(time, "time", lambda: soon),
    ):
        step()
        with pytest.raises(StorageFull):
            store.put(OTHER, b"x" * 100, document(OTHER))
        assert store.exists(ASKED)
    monkeypatch.setattr(time, "time", lambda: ended + HANDOVER_S + 1)
    store.put(OTHER, b"x" * 100, document(OTHER))
    assert not store.exists(ASKED)
