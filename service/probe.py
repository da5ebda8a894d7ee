"""Ask the service of this machine whether it is ready: exit code 0, or 1. For health checks, which must cost little.

It asks where GAPMES_HOST and GAPMES_PORT say: the options of `gapmes serve` belong to another process, which it knows
nothing of.
"""

from __future__ import annotations

import http.client
import os
import sys
import urllib.request

TIMEOUT_S = 4.0
LOOPBACK = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # where a service answers that listens on every address


def address(host: str, port: str) -> str:
    """Of a service that listens there."""
    host = LOOPBACK.get(host, host)
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def ready(host: str, port: str) -> bool:
    """Whether /readyz answers 200 in time."""
    try:
        direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with direct.open(f"{address(host, port)}/readyz", timeout=TIMEOUT_S) as answer:
            return answer.status == 200
    except (OSError, ValueError, http.client.HTTPException):
        return False


if __name__ == "__main__":
    host, port = os.environ.get("GAPMES_HOST") or "127.0.0.1", os.environ.get("GAPMES_PORT") or "8000"
    sys.exit(0 if ready(host, port) else 1)
