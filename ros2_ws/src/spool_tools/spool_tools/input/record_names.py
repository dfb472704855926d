"""Names of records on the command line: files, namespaces."""

from __future__ import annotations

from pathlib import Path


def split_name(text: str) -> tuple[str, str]:
    """Return namespace and file of ``NAME=FILE``; the name is empty where there is only a file."""
    name, mark, file = text.partition("=")
    if not mark or Path(text).exists():
        return "", text
    return name.strip().strip("/"), file.strip()
