"""Files that a run leaves as values to compare: without pictures, long tables and bags by their sums."""

from __future__ import annotations

import contextlib
import csv
import gzip
import json
import math
import sqlite3
import zipfile
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

PICTURE = "[picture]"
#: Lines or values beyond which a table, an array or a topic is recorded by count, ends and sums.
MOST = 60

#: Diagnostics that depend on the speed and size of the machine.
OF_MACHINE = (
    *("free_space_B", "recorded_B", "total_size_B", "waiting_B", "messages", "snapshots", "cpu_time_s"),
    "resident_B",
)


class _Text(HTMLParser):
    """Text of a page, a line for each block; a picture is a marker, code is left out."""

    text, inside = "", 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.inside += tag in ("script", "style", "svg")
        if tag in ("svg", "img", "canvas"):
            self.text += PICTURE
        elif tag not in ("b", "i", "em", "strong", "code", "a", "sub", "sup", "abbr", "small"):
            self.text += " | " if tag in ("td", "th", "span") else "\n"

    def handle_endtag(self, tag: str) -> None:
        self.inside -= tag in ("script", "style", "svg")

    def handle_data(self, data: str) -> None:
        self.text += "" if self.inside else " ".join(f"[{data}]".split())[1:-1]


def page_text(text: str) -> list[str]:
    """Return the lines of text of a page in HTML."""
    reader = _Text()
    reader.feed(text)
    return [line.strip() for line in reader.text.split("\n") if line.strip()]


def summary(values: list[Any]) -> Any:
    """Return few values as they are, of many or fractions the ends and sums, or the texts that differ."""
    if len(values) <= MOST and not any(isinstance(one, float) for one in values):
        return values
    numbers = [float(one) for one in values if isinstance(one, int | float) and math.isfinite(one)]
    told = {"count": len(values), "finite": len(numbers), "first": values[0], "last": values[-1]}
    if len(numbers) < len(values) / 2:
        return told | {"different": sorted({str(one) for one in values})[:MOST]}
    squares = math.fsum(one * one for one in numbers)
    return told | {"sum": math.fsum(numbers), "rms": math.sqrt(squares / len(numbers))}


def columns(rows: list[dict[str, Any]]) -> dict[str, Any]:
    names = dict.fromkeys(key for row in rows for key in row)
    return {name: summary([row.get(name) for row in rows]) for name in names}


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (path, value) of each number, text and list of lines."""
    if isinstance(value, dict):
        for key, below in value.items():
            yield from leaves(below, f"{path}, {key}" if path else str(key))
    elif isinstance(value, list) and not (value and all(isinstance(one, str) for one in value)):
        for index, below in enumerate(value):
            yield from leaves(below, f"{path} [{index}]")
    else:
        yield path, value


def plain(value: Any) -> Any:
    """Return a message as JSON can hold it; of long arrays their summary."""
    fields = getattr(value, "__dataclass_fields__", None) or getattr(value, "_fields_and_field_types", None)
    if fields:
        return {name: plain(getattr(value, name)) for name in fields if not name.startswith("__")}
    if isinstance(value, bytes):
        return value.hex()
    if value is None or isinstance(value, str | bool | int | float):
        return value
    items = value.tolist() if hasattr(value, "tolist") else list(value)
    if items and hasattr(items[0], "key"):  # of diagnostics
        return {one.key: one.value for one in items if one.key not in OF_MACHINE}
    long = len(items) > 12 and isinstance(items[0], float)
    return summary(items) if long else [plain(one) for one in items]


def bag(folder: Path) -> dict[str, Any]:
    """Return type, count and decoded content of each topic of a bag."""
    from rosbags.highlevel import AnyReader, AnyReaderError  # noqa: PLC0415 - slow to load

    rows: dict[str, list[dict[str, Any]]] = {}
    with AnyReader([folder]) as reader:
        for connection, at, data in reader.messages():
            try:
                row = dict(leaves(plain(reader.deserialize(data, connection.msgtype))))
            except AnyReaderError as error:
                row = {"not decoded": str(error), "bytes": len(data)}
            row = {"type": connection.msgtype, "received": at, **row}
            rows.setdefault(connection.topic, []).append(row)
    return {topic: {"count": len(one), **columns(one)} for topic, one in sorted(rows.items())}


def number(text: Any) -> Any:
    with contextlib.suppress(TypeError, ValueError):
        return float(text)
    return text


def table(text: str) -> Any:
    """Return the lines of a short table, the columns of a long one."""
    lines = text.splitlines()
    rows = csv.DictReader(lines) if len(lines) > MOST else ()
    return columns([{str(key): number(one) for key, one in row.items()} for row in rows]) or lines


def database(path: Path) -> dict[str, Any]:
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as base:
        names = [row[0] for row in base.execute("SELECT name FROM sqlite_master WHERE type='table'")]
        return {one: [list(map(plain, row)) for row in base.execute(f"SELECT * FROM {one}")] for one in names}


def parquet(path: Path) -> dict[str, Any]:
    from pyarrow.parquet import ParquetFile  # noqa: PLC0415 - slow to load

    return columns(ParquetFile(path).read().to_pylist())


READERS: dict[str, Callable[[Path], Any]] = {
    ".html": lambda path: page_text(path.read_text("utf-8")),
    ".json": lambda path: json.loads(path.read_text("utf-8")),
    ".csv": lambda path: table(path.read_text("utf-8")),
    ".gz": lambda path: table(gzip.decompress(path.read_bytes()).decode()),
    ".fmu": lambda path: sorted(zipfile.ZipFile(path).namelist()),
    ".mcap": lambda path: bag(path.parent), ".parquet": parquet, ".sqlite": database,
    **dict.fromkeys((".png", ".svg", ".pdf"), lambda path: PICTURE),
    **dict.fromkeys((".yaml", ".md", ".txt", ".xml", ".jsonl", ".msg", ".srv"),
                    lambda path: path.read_text("utf-8").splitlines()),
}  # fmt: skip


def content(path: Path) -> Any:
    """Return what can be compared of a file, else why it cannot be read."""
    try:
        return READERS.get(path.suffix, lambda _: "[file]")(path)
    except Exception as error:  # a damaged file is a result as well
        return f"[not readable: {type(error).__name__}]"
