"""Names of records on the command line: files, columns, namespaces."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from spool_stream.errors import InputError


def parse_columns(text: str | None) -> Mapping[str, str] | None:
    """Return a file's own names by contract name from ``--columns``.

    Raises:
        InputError: not written as ``name=own,name=own``.
    """
    if text is None:
        return None
    pairs = [pair.partition("=") for pair in text.split(",")]
    for wanted, mark, found in pairs:
        if not (wanted and mark and found):
            raise InputError(f"--columns {text!r}: write it like time_s=t,body_m_s2=ch1,spool_m_s2=ch2")
    return {wanted.strip(): found.strip() for wanted, _, found in pairs}


def split_name(text: str) -> tuple[str, str]:
    """Return namespace and file of ``NAME=FILE``; the name is empty where there is only a file."""
    name, mark, file = text.partition("=")
    if not mark or Path(text).exists():
        return "", text
    return name.strip().strip("/"), file.strip()
