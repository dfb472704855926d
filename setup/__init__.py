"""Set-up behind `./spool`: environment, build, hand-over. Standard library only."""

import sys
from pathlib import Path

# Of the suite, which need not be installed, the modules that need Python's own library alone.
sys.path += [str(Path(__file__).parents[1] / "ros2_ws/src" / name) for name in ("spool_core", "spool_tools")]
