"""`python -m pinmobile`, for where the command is not on the PATH."""

import sys

from pinmobile.cli import main

sys.exit(main())
