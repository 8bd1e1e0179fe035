"""`python -m posefuse` is the command line, too."""

import subprocess
import sys

import posefuse


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run([sys.executable, "-m", "posefuse", "--version"], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["posefuse", posefuse.__version__]
