"""`python -m gapmes.model.training OUT`."""

import sys

from ..extra import imports_of

with imports_of("gapmes.model.training"):
    from .command import main

sys.exit(main())
