"""Start of the command line: Ctrl-C ends it in one line while its libraries are still being loaded, too."""

from __future__ import annotations

import sys


def main() -> int:
    """Run the command line; return the exit code."""
    try:
        from .cli import main as run  # noqa: PLC0415 - loading takes up to a second

        return run()
    except KeyboardInterrupt:
        print("spool: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
