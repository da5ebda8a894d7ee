"""The suite also runs where pytest has no processes of its own to spread it over."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
PLAIN = ("-p", "no:xdist", "-p", "no:cacheprovider", "-q", "--collect-only")


def test_the_settings_of_the_suite_do_not_need_it() -> None:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    command = [sys.executable, "-m", "pytest", *PLAIN, __file__]
    found = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert found.returncode == 0, found.stdout + found.stderr
