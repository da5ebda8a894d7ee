"""`make load`, or `python -m benchmarks.load.run [--minutes 1] [--workers 1]`: pictures while scenes are reconstructed.

Prints pictures per second with the median, the 95th and the 99th percentile of their times, first alone and then while
clients request scenes one after the other; the refusals; and the memory of the service, in which growth would show.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

from ..options import at_least_one, duration, none_or_more
from .requests import Asker
from .service import Service, running


class Load:
    """The answers to several clients, with times by kind."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {"picture": [], "scene": []}
        self.active: Counter[str] = Counter()  # seconds of all clients together
        self.refused: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._rounds = 0

    def note(self, kind: str, answer, seconds: float) -> None:
        with self._lock:
            if answer.status_code < 400:
                self.seconds[kind].append(seconds)
            else:
                self.refused[f"{kind}: {answer.json().get('code')}"] += 1

    def clients(self, service: Service, scenes: list[str], pictures: int, reconstructions: int, seconds: float) -> None:
        """Run so many clients of each kind at once, for so many seconds."""
        until = time.monotonic() + seconds

        def ask(kind: str, seed: int) -> None:
            asker, begun = Asker(service.address, seed), time.monotonic()
            while time.monotonic() < until:
                start = time.perf_counter()
                answer = asker.picture(scenes) if kind == "picture" else asker.scene()
                self.note(kind, answer, time.perf_counter() - start)
                if answer.status_code >= 400:
                    time.sleep(0.2)
            with self._lock:
                self.active[kind] += time.monotonic() - begun  # longer than asked for: the last answer is waited for

        kinds = ["picture"] * pictures + ["scene"] * reconstructions
        self._rounds += 1  # other requests in every round: a stored scene costs nothing
        seeds = (1000 * self._rounds + number for number in range(len(kinds)))
        threads = [threading.Thread(target=ask, args=(kind, seed)) for kind, seed in zip(kinds, seeds, strict=False)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def line(self, kind: str, clients: int) -> str:
        """Answers per second of so many clients, and quantiles of their times, none above the longest."""
        times = self.seconds[kind]
        if len(times) < 2:
            return f"{kind:8} {len(times)}"
        cuts = statistics.quantiles(times, n=100, method="inclusive")
        shown = ", ".join(f"p{p} {1000 * cuts[p - 1]:.0f} ms" for p in (50, 95, 99))
        return f"{kind:8} {clients * len(times) / self.active[kind]:6.2f} per second, {shown}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=duration, default=1.0, help="duration of the load with reconstructions")
    parser.add_argument("--workers", type=at_least_one, default=1)
    parser.add_argument("--pictures", type=none_or_more, default=4, help="clients that request pictures")
    parser.add_argument("--scenes", type=none_or_more, default=2, help="clients that request scenes")
    given = parser.parse_args()
    options = ["--workers", str(given.workers)]
    with tempfile.TemporaryDirectory() as folder, running(Path(folder), options) as service:
        asker = Asker(service.address, 1000)
        scenes = [asker.scene().json()["id"] for _ in range(3)]
        for _ in range(10):
            asker.picture(scenes)
        print(f"{len(service.workers())} processes, {given.pictures} clients for pictures", flush=True)
        alone = Load()
        alone.clients(service, scenes, given.pictures, 0, 15.0)
        print("alone:  ", alone.line("picture", given.pictures), flush=True)
        load, wall, first = Load(), 0.0, service.memory_mb()
        rounds = max(2, round(6 * given.minutes))
        for _ in range(rounds):
            seconds = 60 * given.minutes / rounds
            load.clients(service, scenes, given.pictures, given.scenes, seconds)
            wall += seconds
            resident, private, together = service.memory_mb()
            print(
                f"{wall:5.0f} s  resident {resident:4.0f} MB, private {private:4.0f} MB, shared once {together:.0f} MB",
                flush=True,
            )
        print(f"while {given.scenes} clients request scenes:")
        for kind, clients in (("picture", given.pictures), ("scene", given.scenes)):
            print("        ", load.line(kind, clients))
        print("refused: ", dict(load.refused) or "nothing")
        last = service.memory_mb()
        print(f"resident at first {first[0]:.0f} MB, at last {last[0]:.0f} MB, at most {service.peak_mb():.0f} MB")


if __name__ == "__main__":
    main()
