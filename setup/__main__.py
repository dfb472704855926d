"""Start of the set-up, called by the launcher `spool` as `python -S setup`."""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent.parent)

from setup.main import main  # noqa: E402  (the path has to be set first)

sys.exit(main(sys.argv[1:]))
