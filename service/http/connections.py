"""The server's side of a connection: how long it may be silent, how slowly it may read, and how many there may be."""

from __future__ import annotations

import asyncio
import fcntl
import logging
import resource
import struct
import termios

from uvicorn.protocols.http.h11_impl import H11Protocol

from ..process.logs import OVER_LIMIT

HEAD_S = 10  # from the connection, or from the answer before, to the last byte of a request's head
LOOK_S, LEAST = 60.0, 16 * 2**10  # of an answer that the system does not buffer whole, so many bytes go in that time
SHARE, MOST = 3, 1000  # connections: this part of the files that the process may open, and never more
FILES = 2 * SHARE * MOST  # that a process asks for, of those that it may have: twice as many are there for a moment
CROWDED_S = 1.0  # from when there are too many to when one goes: what was sent with a connection is read before
BACKLOG = 128  # connections that the system holds ready, and that are taken at once before any of them is looked at

_log = logging.getLogger("gapmes")


def most_connections() -> int:
    """Of a process at the same time: scenes, uploads and the database need files, too."""
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST if files == resource.RLIM_INFINITY else max(1, min(MOST, files // SHARE))


def ask_for_files() -> None:
    """So many files as the bound of connections needs, or as many as the system allows the process."""
    files, allowed = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = FILES if allowed == resource.RLIM_INFINITY else min(FILES, allowed)
    if files != resource.RLIM_INFINITY and files < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, allowed))


class Connection(H11Protocol):
    """The framework's waits without end for a head and for a reader, and takes any number."""

    _since: float | None = None  # when it began to wait for the head of a request; None while one is answered
    _late: asyncio.TimerHandle | None = None
    _look: asyncio.TimerHandle | None = None
    _left = 0  # bytes of answers that had not gone at the last look
    _moved = False  # whether since then another answer was begun or most of one has gone

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Where there are too many, one that is silent goes: after a moment, in which those of a burst are heard, or at
        once where there are twice as many; then this one, where all others are being answered."""
        super().connection_made(transport)
        self._look = self.loop.call_later(LOOK_S, self._look_at_answer)
        self._wait()
        if len(self.connections) > 2 * most_connections():
            self._make_room()
        elif len(self.connections) > most_connections():
            self.loop.call_later(CROWDED_S, self._make_room)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._wait()

    def on_response_complete(self) -> None:
        self._moved = True
        super().on_response_complete()
        self._wait()

    def pause_writing(self) -> None:
        self._moved = True
        super().pause_writing()

    def resume_writing(self) -> None:
        self._moved = True
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        self._heard()
        if self._look is not None:
            self._look.cancel()
        super().connection_lost(exc)

    def _make_room(self) -> None:
        """Close the one that has been silent for the longest time, if there are too many still."""
        most, silent = most_connections(), self._silent()
        if len(self.connections) > most:
            _log.warning("%s of %d connections is reached: silent ones are closed", OVER_LIMIT, most)
            if silent:
                min(silent, key=lambda one: one._since or 0.0)._close()

    def _silent(self) -> list[Connection]:
        return [one for one in self.connections if isinstance(one, Connection) and one._since is not None]

    def _wait(self) -> None:
        """From now on for the head of a request, where none is being answered."""
        answering = self.cycle is not None and not self.cycle.response_complete
        if answering or self.transport.is_closing():
            self._heard()
        elif self._since is None:
            self._since = self.loop.time()
            self._late = self.loop.call_later(HEAD_S, self._close)

    def _heard(self) -> None:
        self._since = None
        if self._late is not None:
            self._late.cancel()

    def _close(self) -> None:
        self._heard()
        self.timeout_keep_alive_handler()

    def _look_at_answer(self) -> None:
        """End it where a client has stopped reading: what is sent to it may hold a scene, or a file."""
        left = self._unsent()
        if left and self._left and not self._moved and self._left - left < LEAST:
            _log.info("a client has read less than %d bytes in %g s: its connection is closed", LEAST, LOOK_S)
            self.transport.abort()
            return
        self._left, self._moved = left, False
        self._look = self.loop.call_later(LOOK_S, self._look_at_answer)

    def _unsent(self) -> int:
        """Bytes that wait here, and then also those that wait in the system, which takes some megabytes at a time."""
        here = self.transport.get_write_buffer_size()
        if not here:
            return 0
        try:
            there = fcntl.ioctl(self.transport.get_extra_info("socket").fileno(), termios.TIOCOUTQ, bytes(4))
        except OSError:  # no system that tells
            return here
        return here + int(struct.unpack("i", there)[0])
