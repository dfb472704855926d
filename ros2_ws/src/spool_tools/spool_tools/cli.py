"""Command line: finds the command, runs it, and turns what goes wrong into one line and an exit code."""

from __future__ import annotations

import os
import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer
from spool_core.errors import InputError, refused_by_system
from spool_core.faults import show_traceback, unexpected
from spool_core.system import expanded
from spool_report.outputs import fail, one_command
from typer.exceptions import TyperException

from spool_tools.command import CommandGroup, command_modules

app = typer.Typer(
    name="spool",
    cls=CommandGroup,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)

#: Exit code of a fault of the suite: EX_SOFTWARE of sysexits.h.
FAULT = 70
#: Columns below which text is unreadable: the width of a console that knows none is taken.
NARROWEST = 20


def _version(wanted: bool) -> None:
    if wanted:
        from spool_report.outputs import suite_version  # noqa: PLC0415

        print(f"spool {suite_version()}")
        raise typer.Exit


@app.callback()
def everywhere(
    version: Annotated[  # noqa: ARG001 - its callback acts
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=_version)
    ] = False,
) -> None:
    """Monitor hydraulic spool valves: simulate, estimate, monitor, record and replay.

    Example: [bold]./spool demo --seconds 60 --out demo_output[/bold]
    """
    if os.environ.get("COLUMNS", "").isdigit() and int(os.environ["COLUMNS"]) < NARROWEST:
        del os.environ["COLUMNS"]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit code: 0 done, 1 found a problem, 2 bad input, 70 our fault."""
    arguments = [with_home(word) for word in (sys.argv[1:] if arguments is None else arguments)]
    with one_command(arguments):
        try:
            result = app(arguments, prog_name="spool", standalone_mode=False)
        except InputError as error:
            show_traceback(error)
            return fail(str(error))
        except BrokenPipeError:  # the reader of the output has ended: no fault, and nobody to tell
            raise
        except OSError as error:
            show_traceback(error)
            return fail(refused_by_system(error))
        except MemoryError as error:
            show_traceback(error)
            return fail("the memory does not suffice: give a shorter span of the record, or close programs")
        except KeyboardInterrupt:
            return fail("interrupted", 130)
        except typer.Exit as stop:
            return stop.exit_code
        except typer.Abort as abort:
            if isinstance(abort.__cause__, EOFError):  # typer takes the end of any file for Ctrl-D
                # A file ended early, and nothing closer to it named the file.
                place = traceback.extract_tb(abort.__cause__.__traceback__)[-1]
                return fail(
                    f"a file or the input ends too early ({abort.__cause__ or 'EOFError'}; read by "
                    f"{Path(place.filename).name}, line {place.lineno}): a file that was cut off "
                    "must be written or copied again"
                )
            return fail("interrupted", 130)
        except TyperException as error:
            command = next((word for word in arguments if not word.startswith("-")), "")
            command = command if command in command_modules() else ""
            text = error.format_message()
            if not text:  # no arguments: the help has been shown
                return 2
            end = "" if text[-1] in ".?" else "."
            return fail(f"{text}{end} See: ./spool {command} --help".replace("  ", " "))
        except ImportError:  # of libraries: the program names what is missing
            raise
        except Exception as error:
            return fail(unexpected(error), FAULT)
        return result if isinstance(result, int) else 0


def with_home(word: str) -> str:
    """Return an argument with ``~/`` expanded, which shells leave as it is in --json=~/x."""
    option, mark, path = word.partition("=") if word.startswith("--") else ("", "", word)
    return f"{option}{mark}{expanded(path)}" if path.startswith("~/") else word


if __name__ == "__main__":
    sys.exit(main())
