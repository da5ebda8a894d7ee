"""The table of scenes in the store's database: creation, last use, size and a summary of each."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import ServiceBusy, StorageFull
from .database import Database

TOUCH_NS = 60 * 10**9  # resolution of the last use, so that reading a scene seldom writes
NOTE_S = 0.5  # that such a write waits for the lock of another: who reads waits for it, and it may be left out
HANDOVER_S = 2.0  # after a job ended, until all waiting requests have polled it, which they do every 0.2 s
_NOT_WRITTEN = (StorageFull, ServiceBusy, sqlite3.OperationalError)  # errors of a write that may be skipped
UNSET_NS = 1_735_689_600 * 10**9  # 2025: a clock before it is not set yet, so that no other time is corrected by it


@dataclass(frozen=True)
class Indexed:
    """A row of the table `scenes`; times are ns since 1970."""

    id: str
    created_ns: int
    used_ns: int
    bytes: int
    summary: dict[str, Any]


class SceneIndex:
    """The table `scenes`. The folders are authoritative; the store synchronises the table with them when it opens."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, scenes: Iterable[Indexed]) -> None:
        """Insert scenes; existing rows stay unchanged."""
        rows = [(s.id, s.created_ns, s.used_ns, s.bytes, json.dumps(s.summary)) for s in scenes]
        if not rows:
            return
        with self._database.write() as connection:
            connection.executemany("INSERT OR IGNORE INTO scenes VALUES (?, ?, ?, ?, ?)", rows)

    def remove(self, ids: Iterable[str]) -> int:
        """Delete rows; returns how many existed."""
        rows = [(scene_id,) for scene_id in ids]
        if not rows:
            return 0
        with self._database.write() as connection:
            return connection.executemany("DELETE FROM scenes WHERE id = ?", rows).rowcount

    def used(self, scene_id: str) -> None:
        """Set a scene's last use to now; an index that cannot be written is ignored."""
        self._correct("id = ? AND (used_ns < ? OR used_ns > ?)", lambda now: [scene_id, now - TOUCH_NS, now + TOUCH_NS])

    def used_by_now(self) -> None:
        """Set last uses in the future, from a clock that was fast, to now; such scenes would never be evicted."""
        self._correct("used_ns > ?", lambda now: [now + TOUCH_NS])

    def _correct(self, where: str, values: Callable[[int], Sequence[Any]]) -> None:
        """Set the last use of matching rows to now, without a write if there are none."""
        now = time.time_ns()
        if now < UNSET_NS or not self._database.rows(f"SELECT 1 FROM scenes WHERE {where} LIMIT 1", values(now)):
            return
        with contextlib.suppress(*_NOT_WRITTEN), self._database.write(NOTE_S) as connection:
            connection.execute(f"UPDATE scenes SET used_ns = ? WHERE {where}", [now, *values(now)])

    def next_ns(self) -> int:
        """Creation time of a new scene: now, but later than all others even if the clock was fast for them."""
        latest = self._database.rows("SELECT coalesce(max(created_ns), 0) AS latest FROM scenes")[0]["latest"]
        return max(time.time_ns(), latest + 1)

    def ids(self) -> set[str]:
        """Ids of all scenes."""
        return {row["id"] for row in self._database.rows("SELECT id FROM scenes")}

    def page(self, limit: int, after: tuple[int, str] | None = None) -> Sequence[Indexed]:
        """Up to `limit` scenes that follow `after` (created_ns, id), newest first, then by id."""
        where, values = "", []
        if after is not None:
            where, values = "WHERE created_ns < ? OR (created_ns = ? AND id > ?)", [after[0], after[0], after[1]]
        return self._rows(f"SELECT * FROM scenes {where} ORDER BY created_ns DESC, id LIMIT ?", [*values, limit])

    def longest_unused(self, before_ns: int | None = None) -> Sequence[Indexed]:
        """All scenes, least recently used first; with `before_ns` only those not used since then."""
        where, values = ("", []) if before_ns is None else ("WHERE used_ns < ?", [before_ns])
        return self._rows(f"SELECT * FROM scenes {where} ORDER BY used_ns, id", values)

    def awaited(self) -> set[str]:
        """Scenes of active jobs, and of those that ended in the last `HANDOVER_S`, which may not have been read yet."""
        now = time.time()
        rows = self._database.rows(
            "SELECT scene_id FROM jobs WHERE state IN ('queued', 'running') OR ended BETWEEN ? AND ?",
            [now - HANDOVER_S, now + HANDOVER_S],
        )
        return {row["scene_id"] for row in rows}

    def totals(self) -> tuple[int, int]:
        """Number of scenes, and their size in bytes."""
        row = self._database.rows("SELECT count(*) AS n, coalesce(sum(bytes), 0) AS bytes FROM scenes")[0]
        return row["n"], row["bytes"]

    def _rows(self, statement: str, values: Sequence[Any]) -> Sequence[Indexed]:
        return [_indexed(dict(row)) for row in self._database.rows(statement, values)]


def _indexed(row: Mapping[str, Any]) -> Indexed:
    return Indexed(**{**row, "summary": json.loads(row["summary"])})
