"""`python -m posefuse`: the command line, where the script `posefuse` is not on the path."""

import sys

if __name__ == "__main__":
    from posefuse.cli.main import main

    sys.exit(main())
