"""Ask the service of this machine whether it is ready: exit code 0, or 1. For health checks, which must cost little."""

from __future__ import annotations

import os
import sys
import urllib.error
import urllib.request

TIMEOUT_S = 4.0


def ready(port: str) -> bool:
    """Whether /readyz on loopback answers 200 in time."""
    try:
        direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with direct.open(f"http://127.0.0.1:{port}/readyz", timeout=TIMEOUT_S) as answer:
            return answer.status == 200
    except (OSError, ValueError, urllib.error.URLError):
        return False


if __name__ == "__main__":
    sys.exit(0 if ready(os.environ.get("GAPMES_PORT") or "8000") else 1)
