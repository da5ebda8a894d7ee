"""`python -m gapmes.model.training OUT`."""

import sys

from .command import main

sys.exit(main())
