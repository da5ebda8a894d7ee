"""The requests of the load: scenes from the sample's photographs, no two of them equal, and pictures of them."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import httpx

SAMPLE = Path(__file__).parents[2] / "service" / "assets" / "sample"
TIMEOUT_S = 120.0


class Asker:
    """One client; no two of its requests for scenes are equal."""

    def __init__(self, address: str, seed: int) -> None:
        self._random = random.Random(seed)
        self._cameras = json.loads((SAMPLE / "cameras.json").read_text())
        self.client = httpx.Client(base_url=address, timeout=TIMEOUT_S)

    def scene(self, **headers: str) -> httpx.Response:
        """Request a scene from two photographs of the sample."""
        chosen = self._random.sample(range(len(self._cameras["views"])), 2)
        names = [self._cameras["views"][index]["image"] for index in sorted(chosen)]
        parts: list[tuple[str, Any]] = [
            ("images", (Path(n).name, (SAMPLE / n).read_bytes(), "image/png")) for n in names
        ]
        parts.append(("cameras", ("cameras.json", json.dumps(self._cameras).encode(), "application/json")))
        far = self._cameras["far"] * (1 + 1e-6 * self._random.random())  # a different scene for the store
        parts.append(("far", (None, repr(far))))
        return self.client.post("/reconstruct", files=parts, headers=headers)

    def picture(self, scenes: list[str]) -> httpx.Response:
        """Request a picture of one of these scenes, from between its views."""
        view = f"{self._random.random():.4f}"
        return self.client.get("/render", params={"scene": self._random.choice(scenes), "view": view})
