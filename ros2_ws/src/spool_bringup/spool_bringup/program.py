"""Program ``spool``: requests to end are heard before the libraries are loaded, which takes seconds."""

from __future__ import annotations

import importlib
import os
import signal
import sys
from types import FrameType

from spool_core.errors import libraries_reported, refused_by_system
from spool_core.text import drop_output, keep_standard_streams

INTERRUPTED, NOBODY_READS = 130, 141  # what a shell says of SIGINT and SIGPIPE

#: Exit code where standard output takes no more.
UNWRITTEN = 2


def main() -> int:
    """Run the command line; return the exit code."""
    keep_standard_streams()
    for asking in (signal.SIGINT, signal.SIGTERM):
        signal.signal(asking, _leave)
    with libraries_reported("spool"):
        run = importlib.import_module("spool_tools.cli").main
    for asking in (signal.SIGINT, signal.SIGTERM):
        signal.signal(asking, signal.default_int_handler)
    code = 0
    try:
        with libraries_reported("spool"):  # commands load what they need themselves
            code = int(run())
        sys.stdout.flush()
    except BrokenPipeError:
        code = NOBODY_READS
    except OSError as error:  # the last lines do not fit on the disk
        if not code:
            print(f"spool: {refused_by_system(error)}", file=sys.stderr)
        code = code or UNWRITTEN
    except SystemExit as end:  # rich ends so where nobody reads
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        code = NOBODY_READS
    except KeyboardInterrupt:  # while what a command began is taken down
        code = INTERRUPTED
    drop_output()
    return code


def _leave(_number: int, _frame: FrameType | None) -> None:
    """End immediately: nothing is open yet."""
    os.write(2, b"spool: interrupted\n")
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
