"""A worker whose end the process that watches it hears of at once."""

from __future__ import annotations

from uvicorn.supervisors import multiprocess


class WatchedProcess(multiprocess.Process):
    """The watcher asks each worker through a pipe whether it lives, and waits a minute for one that is just starting.

    It must not hold the worker's end of the pipe as well: of one that dies meanwhile it would hear nothing for that
    minute, in which it hears no signal and replaces nobody.
    """

    def start(self) -> None:
        """Start it, and leave its end of the pipe to it alone."""
        super().start()
        self.child_conn.close()


def install() -> None:
    """Have the server watch such processes."""
    multiprocess.Process = WatchedProcess  # type: ignore[misc]
