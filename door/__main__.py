"""Start of the door, called by the launcher `spool` as `python -S door`."""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent.parent)

from door.main import main  # noqa: E402  (the path has to be set first)

sys.exit(main(sys.argv[1:]))
