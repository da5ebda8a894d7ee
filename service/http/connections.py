"""Limits of connections: how long one may be idle, how slowly a client may read, and how many may be open."""

from __future__ import annotations

import asyncio
import fcntl
import logging
import resource
import struct
import termios

from uvicorn.protocols.http.h11_impl import H11Protocol

from ..process.logs import OVER_LIMIT

HEAD_S = 10  # from the start of a connection or the end of the last answer to the end of a request's head
LOOK_S, LEAST = 60.0, 16 * 2**10  # seconds in which a client must take so many bytes of an answer
SHARE, MOST = 3, 1000  # connections: a third of the files that the process may open, but at most 1000
FILES = 2 * SHARE * MOST  # open files to ask for; for a moment there may be twice as many connections
CROWDED_S = 1.0  # before an idle one of too many is closed, so that requests just sent are read
BACKLOG = 128  # of the listening socket; so many connections are accepted at once, before any is read

_log = logging.getLogger("gapmes")


def most_connections() -> int:
    """Largest number of connections of this process; scenes, uploads and the database need open files, too."""
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST if files == resource.RLIM_INFINITY else max(1, min(MOST, files // SHARE))


def ask_for_files() -> None:
    """Raise the soft limit of open files to what the limit of connections needs, or to the hard limit."""
    files, allowed = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = FILES if allowed == resource.RLIM_INFINITY else min(FILES, allowed)
    if files != resource.RLIM_INFINITY and files < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, allowed))


class Connection(H11Protocol):
    """Uvicorn's protocol with timeouts for idle connections and slow readers, and a limit on their number."""

    _since: float | None = None  # loop time since when it has waited for the head of a request; None during an answer
    _late: asyncio.TimerHandle | None = None
    _look: asyncio.TimerHandle | None = None
    _left = 0  # unsent bytes at the last check
    _moved = False  # whether another answer was begun, or a buffer emptied, since then

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """If there are too many connections, close the one that has been idle for longest (this one, if all others are
        being answered): after `CROWDED_S`, in which the requests of a burst are read, or at once if there are twice as
        many."""
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
        """Close the connection that has been idle for longest, if there are still too many."""
        most, silent = most_connections(), self._silent()
        if len(self.connections) > most:
            _log.warning("%s of %d connections is reached: silent ones are closed", OVER_LIMIT, most)
            if silent:
                min(silent, key=lambda one: one._since or 0.0)._close()

    def _silent(self) -> list[Connection]:
        return [one for one in self.connections if isinstance(one, Connection) and one._since is not None]

    def _wait(self) -> None:
        """Start the timeout for the head of the next request, unless one is being answered."""
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
        """Abort the connection if the client has stopped reading: its answer may keep a scene or file in use."""
        left = self._unsent()
        if left and self._left and not self._moved and self._left - left < LEAST:
            _log.info("a client has read less than %d bytes in %g s: its connection is closed", LEAST, LOOK_S)
            self.transport.abort()
            return
        self._left, self._moved = left, False
        self._look = self.loop.call_later(LOOK_S, self._look_at_answer)

    def _unsent(self) -> int:
        """Unsent bytes of the transport and, if there are any, of the socket, whose buffer holds some megabytes."""
        here = self.transport.get_write_buffer_size()
        if not here:
            return 0
        try:
            there = fcntl.ioctl(self.transport.get_extra_info("socket").fileno(), termios.TIOCOUTQ, bytes(4))
        except OSError:  # not supported
            return here
        return here + int(struct.unpack("i", there)[0])
