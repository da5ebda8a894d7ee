"""A service on a local port, as a browser sees it, and pictures read from the browser."""

from __future__ import annotations

import base64
import io
import json
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import uvicorn
from browser_tab import PATIENCE_MS, Tab
from http_requests import camera_object, photograph
from numpy.typing import NDArray
from PIL import Image

from gapmes.service.app import create_app
from gapmes.service.formats.registry import FORMATS
from gapmes.service.gaussians import Gaussians
from gapmes.service.settings import Settings

RECONSTRUCTION_MS = 180_000  # patience, not a limit: three photographs take 15 s of one thread, more beside other work


@contextmanager
def serving(settings: Settings) -> Iterator[str]:
    """The address of the service, once it is ready."""
    listening = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(create_app(settings), log_level="warning"))
    thread = threading.Thread(target=server.run, args=[[listening]], daemon=True)
    thread.start()
    address = f"http://127.0.0.1:{listening.getsockname()[1]}"
    try:
        deadline = time.monotonic() + 300  # the kernels may have to be compiled first
        while not _ready(address):
            assert time.monotonic() < deadline, "not ready in time"
            time.sleep(0.1)
        yield address
    finally:
        server.should_exit = True
        thread.join(30)


def _ready(address: str) -> bool:
    try:
        return httpx.get(f"{address}/readyz", timeout=120).status_code == 200
    except httpx.TransportError:
        return False


@contextmanager
def broken_answers() -> Iterator[str]:
    """An address at which every answer is cut off."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def answer(connection: socket.socket) -> None:
            with connection, suppress(OSError):
                connection.recv(2**16)
                connection.sendall(b'HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n{"scenes": [')

        def listen() -> None:
            with suppress(OSError):  # it is closed at the end
                while True:  # a browser may open connections in advance, and be silent on them
                    threading.Thread(target=answer, args=listening.accept()[:1], daemon=True).start()

        threading.Thread(target=listen, daemon=True).start()
        yield f"http://127.0.0.1:{listening.getsockname()[1]}/"
        listening.shutdown(socket.SHUT_RDWR)


def write_scene(folder: Path, images: list[bytes], cameras: Any) -> list[Path]:
    """Files as a user has them: photographs 0.png, 1.png, … and cameras.json."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for index, data in enumerate(images):
        paths.append(folder / f"{index}.png")
        paths[-1].write_bytes(data)
    paths.append(folder / "cameras.json")
    paths[-1].write_text(cameras if isinstance(cameras, str) else json.dumps(cameras))
    return paths


def choose(page: Any, paths: list[Path]) -> None:
    """Choose files in the browser's own file chooser, as a user does."""
    with page.expect_file_chooser() as chooser:
        page.click("#files")
    chooser.value.set_files(paths)


def choose_two(page: Any, folder: Path, *, seed: int) -> None:
    """Two photographs that fit their cameras are chosen, and may be reconstructed."""
    page.set_input_files("#files", write_scene(folder, [photograph(seed), photograph(seed + 1)], camera_object(2)))
    page.wait_for_selector("#go:not([disabled])")


def cloud(seed: int, *, count: int = 500) -> Gaussians:
    """A heap of small grey Gaussians about the origin."""
    return Gaussians.make(
        np.random.default_rng(seed).normal(size=(count, 3)), np.full((count, 3), 0.05), [[1.0, 0, 0, 0]] * count,
        np.full(count, 0.9), np.full((count, 1, 3), 0.5),
    )  # fmt: skip


def stored_cloud(address: str, seed: int) -> str:
    """The id of a scene that comes into the store as a file, in a moment."""
    answer = httpx.post(
        f"{address}/scenes", files={"file": ("cloud.splat", FORMATS["splat"].write(cloud(seed)).data)}, timeout=120
    )
    assert answer.status_code in (200, 201), answer.text
    return answer.json()["id"]


def cancelled(page: Any, press: Callable[[], None]) -> None:
    """What is pressed cancels the job, and the service knows: a job that may go on before could be done by then."""
    with page.expect_response(lambda answer: answer.request.method == "DELETE" and "/jobs/" in answer.url):
        press()


def document_of(address: str, scene: str) -> Any:
    """The scene document."""
    answer = httpx.get(f"{address}/scenes/{scene}", timeout=120)
    assert answer.status_code == 200, answer.text
    return answer.json()


def patient(page: Any) -> None:
    """The page waits for its frame for as long as a busy machine needs. How long it does else, a clock tells."""
    page.add_init_script(
        f"""{{
          const wait = window.setTimeout;
          window.setTimeout = (act, ms, ...more) => wait(act, ms === 30000 ? {PATIENCE_MS} : ms, ...more);
        }}"""
    )


def pixels_of(page: Any, selector: str) -> NDArray[np.uint8]:
    """(H, W, 3) of what an image element shows, at its own size."""
    code = """async image => {
      await image.decode();
      const canvas = document.createElement("canvas");
      canvas.width = image.naturalWidth; canvas.height = image.naturalHeight;
      canvas.getContext("2d").drawImage(image, 0, 0);
      return canvas.toDataURL("image/png");
    }"""
    address = page.locator(selector).evaluate(code)
    return decoded(base64.b64decode(address.partition(",")[2]))


def decoded(data: bytes) -> NDArray[np.uint8]:
    """(H, W, 3); of 16 bits the upper 8, as a screen has them."""
    image = Image.open(io.BytesIO(data))
    if image.mode.startswith("I"):
        grey = (np.asarray(image).astype(np.uint16) >> 8).astype(np.uint8)
        return np.stack([grey] * 3, axis=-1)
    return np.asarray(image.convert("RGB"))


def rendered(address: str, **query: str) -> NDArray[np.uint8]:
    """The service's own picture."""
    answer = httpx.get(f"{address}/render", params=query, timeout=60)
    assert answer.status_code == 200, answer.text
    return decoded(answer.content)


def opened(tab: Tab, scene: str) -> Any:
    """The page with this scene, drawn by the service."""
    page = tab.open(f"/?scene={scene}")
    page.click("#mode-server")
    page.wait_for_selector("#picture[src^='blob:']")
    return page


def until(page: Any, holds: Callable[[], Any]) -> None:
    """Let the browser's events come until the condition holds, for as long as the page's own waits last."""
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while not holds():
        assert time.monotonic() < deadline, "the page did not come so far"
        page.wait_for_timeout(10)


def settled(page: Any) -> None:
    """What was done has arrived, movements with the next frame, and no picture is to come: the last is the full one."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    page.wait_for_selector("#stage[aria-busy=false]")


def made(page: Any, before: str) -> str:
    """The id of the scene on show, once it is another one than at the address `before`, however busy the machine is."""
    another = re.compile(r"/\?scene=[0-9a-f]{32}$")
    page.wait_for_url(lambda url: url != before and another.search(url), timeout=RECONSTRUCTION_MS)
    page.wait_for_selector("#picture[src^='blob:']")
    return page.url.rpartition("=")[2]
