"""Kill processes at random under load: `python -m benchmarks.load.faults [--seconds 60] [--workers 2]`.

Clients request scenes and jobs while a worker is killed from time to time. Afterwards every scene that a client was
given must exist, complete and unchanged, and every accepted job must have ended. Exits with code 1 if one does not.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import signal
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

import httpx

from gapmes.service.formats.ply import read_ply

from ..options import at_least_one, duration, none_or_more
from .requests import Asker
from .service import Service, running


class Promises:
    """The answers that clients were given."""

    def __init__(self) -> None:
        self.scenes: dict[str, str] = {}  # location: sha256 of the .ply
        self.jobs: list[str] = []
        self.broken = 0  # connections that were closed without an answer
        self.refused = Counter[str]()  # by the code of the problem

    def ask(self, service: Service, seed: int, until: float) -> None:
        """Alternate between a scene, which is waited for, and a job, which is not."""
        asker, turn = Asker(service.address, seed), 0
        while time.monotonic() < until:
            turn += 1
            try:
                if turn % 2:
                    answer = asker.scene(Accept="application/octet-stream")
                    if answer.status_code in (200, 201):
                        self.scenes[answer.headers["location"]] = hashlib.sha256(answer.content).hexdigest()
                        continue
                else:
                    answer = asker.scene(Prefer="respond-async")
                    if answer.status_code == 202:
                        self.jobs.append(answer.headers["location"])
                        continue
                self.refused[answer.json()["code"]] += 1
                time.sleep(0.3)
            except httpx.TransportError:
                self.broken += 1
                time.sleep(0.3)


def kill_now_and_then(service: Service, until: float, seed: int) -> int:
    """Kill one worker at a time, after 1 to 6 seconds each; returns how many were killed."""
    chance, killed = random.Random(seed), 0
    while True:
        time.sleep(chance.uniform(1, 6))
        if time.monotonic() > until:
            return killed
        os.kill(chance.choice(service.workers()), signal.SIGKILL)
        killed += 1


def kept(service: Service, promises: Promises) -> list[str]:
    """The promises that were not kept."""
    wrong = []
    with httpx.Client(base_url=service.address, timeout=60) as client:
        for location, digest in promises.scenes.items():
            answer = client.get(location + ".ply")
            if answer.status_code != 200 or hashlib.sha256(answer.content).hexdigest() != digest:
                wrong.append(f"{location}: {answer.status_code}")
        deadline = time.monotonic() + 600
        for location in promises.jobs:
            while (job := client.get(location).json())["state"] in ("queued", "running"):
                if time.monotonic() > deadline:
                    break
                time.sleep(0.2)
            if job["state"] == "done":
                if len(read_ply(client.get(job["links"]["scene"] + ".ply").content)) == 0:
                    wrong.append(f"{location}: an empty scene")
            elif job["state"] != "failed" or job["problem"]["code"] != "job_abandoned":
                wrong.append(f"{location}: {job}")
    for folder in service.store.iterdir():
        if len(folder.name) == 32 and not whole(folder):
            wrong.append(f"{folder.name} is half a scene")
    return wrong


def whole(folder: Path) -> bool:
    """Whether a scene's folder has its .ply, its document, the pictures of its inputs, and nothing else."""
    names = {path.name for path in folder.iterdir()}
    if "scene.json" not in names:
        return False
    inputs = json.loads((folder / "scene.json").read_bytes()).get("inputs", 0)
    return names == {"scene.ply", "scene.json", *(f"input_{index}.png" for index in range(inputs))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=duration, default=60.0)
    parser.add_argument("--workers", type=at_least_one, default=2)
    parser.add_argument("--seed", type=none_or_more, default=0)
    given = parser.parse_args()
    options = ["--workers", str(given.workers), "--threads", "1"]
    with tempfile.TemporaryDirectory() as folder, running(Path(folder), options) as service:
        promises, until = Promises(), time.monotonic() + given.seconds
        clients = [threading.Thread(target=promises.ask, args=(service, seed, until)) for seed in range(3)]
        for client in clients:
            client.start()
        killed = kill_now_and_then(service, until, given.seed)
        for client in clients:
            client.join()
        refused = ", ".join(f"{count} requests refused as {code}" for code, count in promises.refused.most_common())
        print(
            f"{killed} processes killed; {len(promises.scenes)} scenes and {len(promises.jobs)} jobs acknowledged, "
            f"{promises.broken} connections broken, {refused or 'no request refused'}",
            flush=True,
        )
        wrong = kept(service, promises)
    for line in wrong:
        print("BROKEN PROMISE", line)
    raise SystemExit(1 if wrong else 0)


if __name__ == "__main__":
    main()
