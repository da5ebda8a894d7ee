"""Early check of the address that the service is to listen on."""

from __future__ import annotations

import errno
import socket
from typing import Any

from ..errors import InputError

_NOT_HERE = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT, errno.EINVAL)


def check_address(host: str, port: int, workers: int) -> None:
    """Raises `InputError` if `host` is no address of this machine, or the port is in use or needs privileges."""
    try:
        found = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (socket.gaierror, UnicodeError) as error:
        raise _not_here(host, getattr(error, "strerror", None) or str(error)) from error
    failures = [failure for failure in (_failure(*info, workers=workers) for info in found) if failure is not None]
    for failure in failures:
        if failure.errno not in _NOT_HERE:
            forbidden = failure.errno == errno.EACCES
            raise InputError(
                f"the service cannot listen on port {port} of {host}: {failure.strerror}",
                field="port",
                cure="let GAPMES_PORT or --port name " + ("one from 1024 on" if forbidden else "one that is free"),
            ) from failure
    if len(failures) == len(found):  # one of the two addresses of localhost may be missing
        raise _not_here(host, str(failures[0].strerror)) from failures[0]


def _failure(family: int, kind: int, protocol: int, _: str, address: Any, *, workers: int) -> OSError | None:
    """The error of binding to the address, None if it can be bound. As in the server, a single process binds IPv6 only;
    a socket that several share also accepts IPv4."""
    try:
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a port that was just closed counts as free
            if family == socket.AF_INET6 and workers == 1:
                probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            probe.bind(address)
    except OSError as error:
        return error
    return None


def _not_here(host: str, why: str) -> InputError:
    return InputError(
        f"the service cannot listen on {host!r}: {why}",
        field="host",
        cure="let GAPMES_HOST or --host name an address of this machine, such as 127.0.0.1, or 0.0.0.0 for all",
    )
