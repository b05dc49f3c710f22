"""``python -m cyclofeat`` is the ``cyclofeat`` command."""

import sys

from cyclofeat.cli import main

sys.exit(main())
