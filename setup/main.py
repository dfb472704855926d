"""Main program of `./spool`: sets up what is missing and hands over to the command line of the suite."""

from __future__ import annotations

import ast
import difflib
import os
import re
import signal
import sys
from pathlib import Path

from spool_core.text import keep_standard_streams

from setup import requirements, workspace
from setup.layout import Layout, SetupError, find_underlay
from setup.process import say

ROOT = Path(__file__).resolve().parent.parent
#: Commands that start nodes or talk to those of `run`: on this host alone unless the caller says more.
LOCAL_BY_DEFAULT = (
    "demo", "test", "bench", "run", "python", "alarm", "analyse", "baseline", "snapshot", "watch", "doctor",
)  # fmt: skip
HELP = """Usage: ./spool COMMAND [arguments]       ./spool COMMAND --help shows details and an example

{commands}
The first call sets the project up (one to three minutes): it needs Linux x86-64, Python 3.10 to 3.13 with
venv, a C++ compiler and make. Where a ROS 2 is sourced, it builds on that one.
./spool --version says which version this is; after ./spool --install-completion Tab completes in new shells.
Example: ./spool demo --seconds 60 --out demo_output
"""
#: Options without a command, once the project is set up.
OPTIONS = ("--version", "--install-completion", "--show-completion")
#: The tests of a file stay together, in the order of conftest.py.
SPREAD = ("-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder")
#: Set by a shell that completes a command line.
COMPLETION = "_SPOOL_COMPLETE"

#: The launcher's own: name, place in the list, and what it does.
OWN = (
    ("test", 540, "run the tests; takes pytest's arguments, -m '' adds the slow ones, --changed selects"),
    ("package", 550, "a Debian package with its own environment, and its bill of materials"),
)
SUFFIX = "_command.py"


def main(arguments: list[str]) -> int:
    """Run one call of `./spool`; does not return where another program takes over.

    Args:
        arguments: of the command line, without the program.

    Returns:
        Exit code.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C
    keep_standard_streams()
    try:
        return _run(arguments)
    except BrokenPipeError:  # the reader of the output has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 141
    except SetupError as error:
        say(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        say("interrupted: call again to go on")
        return 130


def commands(root: Path) -> dict[str, str]:
    """Return what each command does by its name, in their places.

    Args:
        root: of the repository.
    """
    files = [
        *(root / "ros2_ws").glob(f"[as]*/*/spool_*/**/*{SUFFIX}"),
        *(root / "research").glob(f"*/commands/*{SUFFIX}"),
    ]
    found = [(file.name.removesuffix(SUFFIX).replace("_", "-"), *_declared(file)) for file in files]
    return {name: line for name, _, line in sorted([*OWN, *found], key=lambda entry: entry[1])}


def listing(root: Path) -> str:
    """Return the lines of the list that `./spool --help` shows before anything is set up."""
    return "".join(f"  {name:9} {line}\n" for name, line in commands(root).items())


def _run(arguments: list[str]) -> int:
    environment = dict(os.environ)
    environment.pop("__PYVENV_LAUNCHER__", None)
    if not re.fullmatch(r"[A-Za-z0-9_-]*", environment.get("ROS_DISTRO", "")):
        raise SetupError("ROS_DISTRO is no name of a ROS distribution: unset it, or source a ROS 2")
    layout = Layout(ROOT, find_underlay(ROOT, environment))
    done = requirements.load(layout)
    command = arguments[0] if arguments else "--help"
    if COMPLETION in environment and not done.built:
        return 0  # Tab must not set anything up
    if command == "doctor" and "--live" not in arguments:
        from setup.doctor import doctor  # noqa: PLC0415  (a later call has to start immediately)

        return doctor(layout, done, environment, arguments[1:])

    if command == "package":
        from setup.packaging.package import package  # noqa: PLC0415  (a later call has to start immediately)

        return package(ROOT, environment, arguments[1:])

    if not done.built:
        if command in ("--help", "-h", "help"):
            print(HELP.format(commands=listing(ROOT)), end="")
            return 0
        known = list(commands(ROOT))
        if command not in (*known, *OPTIONS):
            near = difflib.get_close_matches(command, known, n=1)
            meant = f", did you mean {near[0]}?" if near else ":"
            raise SetupError(f"no command {command}{meant} ./spool --help lists them")
    if environment.get("ROS_LOCALHOST_ONLY", "0") not in ("", "0"):
        say(
            "ROS_LOCALHOST_ONLY is deprecated: ROS 2 Jazzy still follows it, a later release may not: "
            "use ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
        )

    from setup.installation import ensure, is_current  # noqa: PLC0415

    if not is_current(layout, done):
        ensure(layout, environment)
    _hand_over(layout, environment, arguments or ["--help"])
    return 0


def _hand_over(layout: Layout, environment: dict[str, str], arguments: list[str]) -> None:
    run = workspace.run_environment(layout, environment)
    # Threads for the small matrices of a valve cost more than they gain: an analysis takes a tenth longer.
    run.setdefault("OPENBLAS_NUM_THREADS", "1")
    if arguments[0] in LOCAL_BY_DEFAULT:
        run.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        # The range alone answers a participant elsewhere that names this host.
        local = run["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST" and not run.get("ROS_STATIC_PEERS")
        for name in ("FASTRTPS", "FASTDDS") if local else ():
            run.setdefault(f"{name}_DEFAULT_PROFILES_FILE", str(layout.root / "setup" / "this_host.xml"))
    research = layout.root / "research"
    if research.is_dir():  # studies, benchmarks, the paper: in a checkout only
        run["PYTHONPATH"] = os.pathsep.join(filter(None, (run.get("PYTHONPATH", ""), str(research))))
    python = str(layout.python)
    if arguments[0] == "test":
        os.chdir(layout.root)
        # Tests interrupt programs; what a call in the background ignores, its programs would ignore as well.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        # Without bytecode each worker rewrites the assertions of all tests at each run: 9 s of its processor.
        run.pop("PYTHONDONTWRITEBYTECODE", None)
        command = [python, "-m", "pytest", *SPREAD, *arguments[1:]]
    else:
        # From 3.11 on Python can be told not to import from the user's folder.
        safe = ["-P"] if sys.version_info >= (3, 11) else []
        command = [python, *safe, "-m", "spool_bringup.program", *arguments]
    sys.stdout.flush()
    os.execve(python, command, run)


def _declared(file: Path) -> tuple[int, str]:
    """Return place and line of the module's ``COMMAND = Command(...)``."""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "COMMAND":
            assert isinstance(node.value, ast.Call)
            given = {word.arg: word.value for word in node.value.keywords}
            return ast.literal_eval(given["place"]), ast.literal_eval(given["line"])
    raise ValueError(f"{file}: no COMMAND")
