"""What the store's database knows of its scenes: order, size, last use and a summary, without opening their folders."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import StorageFull
from .database import Database

TOUCH_NS = 60 * 10**9  # last use is known to a minute, so that reading a scene seldom writes
HANDOVER_S = 2.0  # from the end of a job to when all who wait have looked, which they do every fifth of a second
UNSET_NS = 1_735_689_600 * 10**9  # 2025: a clock that is before it has not been set yet, and makes no other stamp wrong


@dataclass(frozen=True)
class Indexed:
    """A scene's row; times are nanoseconds since 1970."""

    id: str
    created_ns: int
    used_ns: int
    bytes: int
    summary: dict[str, Any]


class SceneIndex:
    """The table `scenes`; the folders are the truth, and the store makes the table agree with them when it opens."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, scenes: Iterable[Indexed]) -> None:
        """List scenes; those that are listed stay as they are."""
        rows = [(s.id, s.created_ns, s.used_ns, s.bytes, json.dumps(s.summary)) for s in scenes]
        if not rows:
            return
        with self._database.write() as connection:
            connection.executemany("INSERT OR IGNORE INTO scenes VALUES (?, ?, ?, ?, ?)", rows)

    def remove(self, ids: Iterable[str]) -> int:
        """Forget scenes; returns how many of them were listed."""
        rows = [(scene_id,) for scene_id in ids]
        if not rows:
            return 0
        with self._database.write() as connection:
            return connection.executemany("DELETE FROM scenes WHERE id = ?", rows).rowcount

    def used(self, scene_id: str) -> None:
        """Note that a scene was read now; where that cannot be written, reading goes on all the same."""
        self._correct("id = ? AND (used_ns < ? OR used_ns > ?)", lambda now: [scene_id, now - TOUCH_NS, now + TOUCH_NS])

    def used_by_now(self) -> None:
        """No last use lies ahead: what a clock that was fast has noted, which would outlast all others, becomes now."""
        self._correct("used_ns > ?", lambda now: [now + TOUCH_NS])

    def _correct(self, where: str, values: Callable[[int], Sequence[Any]]) -> None:
        """Set the last use to now where it is wrong; the write is spared where nothing is."""
        now = time.time_ns()
        if now < UNSET_NS or not self._database.rows(f"SELECT 1 FROM scenes WHERE {where} LIMIT 1", values(now)):
            return
        with contextlib.suppress(StorageFull, sqlite3.OperationalError), self._database.write() as connection:
            connection.execute(f"UPDATE scenes SET used_ns = ? WHERE {where}", [now, *values(now)])

    def next_ns(self) -> int:
        """The instant of a scene that is made now, by the clock, but after all others though it was fast then."""
        latest = self._database.rows("SELECT coalesce(max(created_ns), 0) AS latest FROM scenes")[0]["latest"]
        return max(time.time_ns(), latest + 1)

    def ids(self) -> set[str]:
        """All of them."""
        return {row["id"] for row in self._database.rows("SELECT id FROM scenes")}

    def page(self, limit: int, after: tuple[int, str] | None = None) -> Sequence[Indexed]:
        """Newest first, scenes of the same instant by id; those behind `after` (created_ns, id)."""
        where, values = "", []
        if after is not None:
            where, values = "WHERE created_ns < ? OR (created_ns = ? AND id > ?)", [after[0], after[0], after[1]]
        return self._rows(f"SELECT * FROM scenes {where} ORDER BY created_ns DESC, id LIMIT ?", [*values, limit])

    def longest_unused(self, before_ns: int | None = None) -> Sequence[Indexed]:
        """By last use, oldest first; with `before_ns` those alone whose last use is older."""
        where, values = ("", []) if before_ns is None else ("WHERE used_ns < ?", [before_ns])
        return self._rows(f"SELECT * FROM scenes {where} ORDER BY used_ns, id", values)

    def awaited(self) -> set[str]:
        """Scenes of jobs that are not over, or have been for a moment: who asked for one may not have seen it yet."""
        now = time.time()
        rows = self._database.rows(
            "SELECT scene_id FROM jobs WHERE state IN ('queued', 'running') OR ended BETWEEN ? AND ?",
            [now - HANDOVER_S, now + HANDOVER_S],
        )
        return {row["scene_id"] for row in rows}

    def totals(self) -> tuple[int, int]:
        """How many scenes, and their bytes."""
        row = self._database.rows("SELECT count(*) AS n, coalesce(sum(bytes), 0) AS bytes FROM scenes")[0]
        return row["n"], row["bytes"]

    def _rows(self, statement: str, values: Sequence[Any]) -> Sequence[Indexed]:
        return [_indexed(dict(row)) for row in self._database.rows(statement, values)]


def _indexed(row: Mapping[str, Any]) -> Indexed:
    return Indexed(**{**row, "summary": json.loads(row["summary"])})
