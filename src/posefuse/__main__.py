"""`python -m posefuse`: the command line, where the script `posefuse` is not on the path."""

import sys

from posefuse.cli.main import main

sys.exit(main())
