"""Commands of the suite, as their modules declare them: read as text, since nothing may be installed yet."""

from __future__ import annotations

import ast
from pathlib import Path

#: The launcher's own: name, place in the list, and what it does.
OWN = (
    ("test", 15, "the tests of the repository; takes pytest's arguments, -m '' adds the slow ones"),
    ("package", 990, "a Debian package with its own environment, and its bill of materials"),
)
SUFFIX = "_command.py"


def commands(root: Path) -> dict[str, str]:
    """Return what each command does by its name, in their places.

    Args:
        root: of the repository.
    """
    files = [
        *(root / "ros2_ws" / "src").glob(f"*/*/**/commands/*{SUFFIX}"),
        *(root / "research").glob(f"*/commands/*{SUFFIX}"),
    ]
    found = [(file.name.removesuffix(SUFFIX), *_declared(file)) for file in files]
    return {name: line for name, _, line in sorted([*OWN, *found], key=lambda entry: entry[1])}


def _declared(file: Path) -> tuple[int, str]:
    """Return place and line of the module's ``COMMAND = Command(...)``."""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "COMMAND":
            assert isinstance(node.value, ast.Call)
            given = {word.arg: word.value for word in node.value.keywords}
            return ast.literal_eval(given["place"]), ast.literal_eval(given["line"])
    raise ValueError(f"{file}: no COMMAND")


def listing(root: Path) -> str:
    """Return the lines of the list that `./spool --help` shows before anything is set up."""
    return "".join(f"  {name:9} {line}\n" for name, line in commands(root).items())
