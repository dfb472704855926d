"""Hooks of the documentation site: pages made from code, READMEs as pages, every link checked.

Links in the Markdown files are those of the repository, where people read them as well. In the site a link
to a page leads there, and a link to any other file becomes its path as text. A link to a file that does not
exist stops the build.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PACKAGES = ROOT / "ros2_ws"
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")
FENCE = re.compile(r"^(```.*?^```$)", re.M | re.S)
#: Pages outside of docs/ by their place in the site.
OUTSIDE = {
    "contributing.md": ROOT / "CONTRIBUTING.md",
    "changelog.md": ROOT / "CHANGELOG.md",
    "security_policy.md": ROOT / "SECURITY.md",
    "bags.md": ROOT / "bags" / "README.md",
    **{
        f"packages/{'_'.join(path.relative_to(PACKAGES).with_suffix('').parts[1:]).lower()}.md": path
        for path in sorted(PACKAGES.glob("[as]*/spool_*/**/*.md"))
        if "vendor" not in path.parts and "test" not in path.parts
    },
}
PLACES = {path: place for place, path in OUTSIDE.items()}


def commands_page() -> str:
    """Return the help of every command."""
    from spool_tools.cli import app  # noqa: PLC0415 - the suite is needed here only
    from typer.main import get_command  # noqa: PLC0415

    os.environ.update(TERMINAL_WIDTH="100", NO_COLOR="1")
    parts = ["# Commands\n\nMade from the help of the commands.\n"]
    pending: list[tuple[str, Any]] = [("spool", get_command(app))]
    while pending:
        path, command = pending.pop(0)
        context = command.make_context(path, [], resilient_parsing=True)
        if hasattr(command, "list_commands"):
            names = [
                name for name in command.list_commands(context) if name not in ("bench", "paper", "study")
            ]
            pending = [(f"{path} {name}", command.get_command(context, name)) for name in names] + pending
        if path == "spool":
            continue
        parts.append(f"## {path}\n\n{command.help or ''}\n")
        rows = [one for one in command.params if getattr(one, "help", None)]
        if rows:
            parts.append("| option | meaning |\n|---|---|")
            for one in rows:
                words = ", ".join(f"`{word}`" for word in one.opts)
                parts.append(f"| {words} | {str(one.help).replace('|', '&#124;')} |")
            parts.append("")
    if len(parts) == 1:
        raise PluginError("no command is installed: build the site by ./spool, as .ci/run does")
    return "\n".join(parts).replace("[bold]", "").replace("[/bold]", "")


def messages_page() -> str:
    """Return the definitions of all messages and services."""
    parts = ["# Messages and services\n\nMade from the definitions in `spool_msgs`.\n"]
    for path in sorted((PACKAGES / "src" / "spool_msgs").glob("*/*.[ms][sr][gv]")):
        parts.append(f"## {path.stem}\n\n```text\n{path.read_text('utf-8').strip()}\n```\n")
    return "\n".join(parts)


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made, and those outside of docs/."""
    for place, path in OUTSIDE.items():
        files.append(File.generated(config, place, abs_src_path=str(path)))
    files.append(File.generated(config, "reference/commands.md", content=commands_page()))
    files.append(File.generated(config, "reference/messages.md", content=messages_page()))
    return files


def on_page_markdown(markdown: str, page: Any, files: Any, **_given: Any) -> str:
    """Turn links of the repository into links of the site."""
    place = page.file.src_uri
    source = OUTSIDE.get(place, DOCS / place)

    def link(found: re.Match[str]) -> str:
        text, target, anchor = found[1], found[2], found[3] or ""
        path = (source.parent / target).resolve()
        if path.is_relative_to(DOCS) and files.get_file_from_path(path.relative_to(DOCS).as_posix()):
            inside = path.relative_to(DOCS).as_posix()
        elif path in PLACES:
            inside = PLACES[path]
        elif path.exists():
            return f"{text} (`{path.relative_to(ROOT).as_posix()}`)"
        else:
            raise PluginError(f"{source.relative_to(ROOT)}: there is no {target}: correct the link")
        return f"[{text}]({os.path.relpath(inside, Path(place).parent.as_posix())}{anchor})"

    parts = FENCE.split(markdown)
    return "".join(part if part.startswith("```") else LINK.sub(link, part) for part in parts)
