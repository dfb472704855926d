"""What is public: Python interface, commands with their options, messages. A change must be meant.

``docs/public.txt`` lists it; ``./spool python tests/test_public_interface.py`` writes the list again.
CHANGELOG.md describes which changes need which version.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import spool
from spool_tools.cli import app
from typer.main import get_command

ROOT = Path(__file__).resolve().parent.parent
LIST = ROOT / "docs" / "public.txt"
SOURCE = ROOT / "ros2_ws" / "src"
#: Commands that only a checkout has.
RESEARCH = {"bench", "paper", "study"}


def python_lines() -> Iterator[str]:
    for name in spool.__all__:
        entry = getattr(spool, name)
        if inspect.isclass(entry):
            yield f"class spool.{name}"
            for member in sorted(dir(entry)):
                found = inspect.getattr_static(entry, member)
                if member.startswith("_") or hasattr(ValueError, member):
                    continue
                shown = str(inspect.signature(found)) if inspect.isfunction(found) else ""
                yield f"spool.{name}.{member}{shown}"
        else:
            yield f"spool.{name}{inspect.signature(entry)}"


def command_lines(group: Any = None, path: str = "spool") -> Iterator[str]:
    group = group or get_command(app)
    context = group.make_context(path, [], resilient_parsing=True)
    for name in sorted(set(group.list_commands(context)) - RESEARCH):
        command = group.get_command(context, name)
        if hasattr(command, "list_commands"):
            yield from command_lines(command, f"{path} {name}")
            continue
        shown = [one for one in command.params if not getattr(one, "hidden", False)]
        words = [word for one in shown for word in (*one.opts, *one.secondary_opts)]
        yield f"{path} {name}: {' '.join(sorted(words))}"


def message_lines() -> Iterator[str]:
    for path in sorted((SOURCE / "spool_msgs").glob("*/*.[ms][sr][gv]")):
        fields = [line.split("#")[0].split() for line in path.read_text("utf-8").splitlines()]
        yield f"{path.stem}: {'; '.join(' '.join(words) for words in fields if words)}"


def lines() -> str:
    return "\n".join([*python_lines(), "", *command_lines(), "", *message_lines(), ""])


def test_the_list_of_what_is_public_is_that_of_the_code() -> None:
    assert LIST.read_text("utf-8") == lines(), (
        "the public interface changed: if that is meant, add a line to CHANGELOG.md, raise the version as "
        "described there, and type ./spool python tests/test_public_interface.py"
    )


def test_every_package_has_the_version_of_the_changelog() -> None:
    versions = {
        ElementTree.parse(path).findtext("version") for path in SOURCE.parent.glob("*/spool_*/package.xml")
    }
    newest = re.findall(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.M)[0]
    assert versions == {newest}


if __name__ == "__main__":
    LIST.write_text(lines(), encoding="utf-8")
