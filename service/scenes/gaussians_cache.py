"""An LRU cache of decoded Gaussians, bounded in bytes, of the files that they were read from."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable

from ..gaussians import Gaussians


class GaussiansCache:
    """Thread-safe. Entries are loaded outside the lock, so that one slow file does not block others."""

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self._entries: OrderedDict[str, tuple[Hashable, Gaussians]] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    @property
    def bytes(self) -> int:
        """Size of all entries, at most `max_bytes`."""
        return self._bytes

    def get(self, key: str, version: Hashable, load: Callable[[], Gaussians]) -> Gaussians:
        """The entry of `key` if it has this `version`, else the result of `load`, which takes its place if it fits."""
        with self._lock:
            held, gaussians = self._entries.get(key, (None, None))
            if gaussians is not None and held == version:
                self._entries.move_to_end(key)
                return gaussians
        gaussians = load()
        with self._lock:
            self._remove(key)
            size = size_of(gaussians)
            if size <= self.max_bytes:
                self._entries[key] = version, gaussians
                self._bytes += size
                while self._bytes > self.max_bytes:
                    self._remove(next(iter(self._entries)))
        return gaussians

    def drop(self, key: str) -> None:
        """Remove an entry, if there is one."""
        with self._lock:
            self._remove(key)

    def _remove(self, key: str) -> None:
        _, gaussians = self._entries.pop(key, (None, None))
        if gaussians is not None:
            self._bytes -= size_of(gaussians)


# What the splatter keeps with a set that it has drawn (`splat/prepare.py`), per Gaussian, padded to blocks of 256: 14
# doubles that hold for every camera and a copy of the harmonics; and 108 bytes for the projection into one camera.
BLOCK, PREPARED_BYTES, PROJECTED_BYTES = 256, 14 * 8, 108


def size_of(gaussians: Gaussians) -> int:
    """Bytes of the arrays, and of what the splatter caches with them."""
    arrays = (gaussians.means, gaussians.scales, gaussians.rotations_wxyz, gaussians.opacities, gaussians.harmonics)
    count = len(gaussians)
    padded = -(-count // BLOCK) * BLOCK
    harmonics = gaussians.harmonics[:1].nbytes if count else 0
    drawing = padded * (PREPARED_BYTES + harmonics) + count * PROJECTED_BYTES
    return sum(array.nbytes for array in arrays) + drawing
