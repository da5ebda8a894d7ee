"""Origins of pages and names of hosts as settings list them: what could never match is refused."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

from .errors import InputError

_ORIGIN = re.compile(  # scheme://host or scheme://host:port, where that is not the port of the scheme
    r"(?!http://.*:80$|https://.*:443$)[a-z][a-z0-9+.-]*://([a-z0-9._~-]+|\[[0-9a-f:.]+\])(:[1-9][0-9]{0,4})?"
)
_HOST = re.compile(r"[A-Za-z0-9._~-]+|\[[0-9A-Fa-f:.]+\]")


def listed(text: str) -> list[str]:
    """The entries of a setting, separated by commas."""
    return [entry for _, entry in _entries(text)]


def _entries(text: str) -> list[tuple[int, str]]:
    """Entries that are not empty, with their places."""
    return [(place, part.strip()) for place, part in enumerate(text.split(",")) if part.strip()]


def checked_origins(text: str) -> str:
    """The text itself. Raises `InputError` for what no browser sends as an origin, which would thus allow nothing."""
    for index, origin in _entries(text):
        if origin not in ("*", "null") and not _ORIGIN.fullmatch(origin):
            raise InputError(
                f"{origin!r} is no origin as browsers send it: scheme, host in small letters, and a port that is not "
                "the scheme's own",
                field="GAPMES_CORS_ORIGINS",
                index=index,
                cure="write it like https://a.example or http://localhost:3000, with no / at its end",
            )
    return text


def checked_hosts(text: str) -> str:
    """The text itself. Raises `InputError` for what no request can name as its host."""
    for index, host in _entries(text):
        if not _HOST.fullmatch(host):
            raise InputError(
                f"{host!r} is no name of a host",
                field="GAPMES_ALLOWED_HOSTS",
                index=index,
                cure="write it like a.example, 10.0.0.5 or [::1], without scheme, port or path",
            )
    return text


def host_name(authority: str) -> str | None:
    """The host of `host`, `host:port` or `[address]:port` in small letters; None if it is none."""
    try:
        url = urlsplit(f"//{authority}")
        return url.hostname if url.netloc == authority and url.username is None and url.port != 0 else None
    except ValueError:  # malformed
        return None
