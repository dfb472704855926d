"""Files that appear whole or not at all, and output that nobody reads any more."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from spool_core import text
from spool_core.system import staged, write_durably


@pytest.mark.parametrize("replace", [True, False])
def test_a_staged_file_has_its_name_at_the_end_and_no_other(tmp_path: Path, replace: bool) -> None:
    with staged(tmp_path / "a", replace=replace) as part:
        part.write_text("new", "utf-8")
        assert not (tmp_path / "a").exists()
    assert (tmp_path / "a").read_text("utf-8") == "new"
    assert list(tmp_path.iterdir()) == [tmp_path / "a"]


@pytest.mark.parametrize("links", [True, False])
def test_what_took_the_name_meanwhile_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    """On a file system with hard links and on one without."""

    def no_links(*_: object, **__: object) -> None:
        raise PermissionError

    if not links:
        monkeypatch.setattr(os, "link", no_links)
    write_durably(tmp_path / "a", "first", replace=False)
    with pytest.raises(FileExistsError):
        write_durably(tmp_path / "a", "second", replace=False)
    assert (tmp_path / "a").read_text("utf-8") == "first"
    write_durably(tmp_path / "a", "third")
    assert (tmp_path / "a").read_text("utf-8") == "third"
    assert list(tmp_path.iterdir()) == [tmp_path / "a"]


def test_nothing_stays_of_a_file_whose_writing_was_interrupted(tmp_path: Path) -> None:
    def interrupted() -> None:
        with staged(tmp_path / "a") as part:
            part.write_text("half", "utf-8")
            raise KeyboardInterrupt

    (tmp_path / "a").write_text("old", "utf-8")
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (tmp_path / "a").read_text("utf-8") == "old"
    assert list(tmp_path.iterdir()) == [tmp_path / "a"]


def test_output_that_nobody_reads_goes_nowhere_and_leaves_no_file_open(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stream:
        stream.write("half a line")
        monkeypatch.setattr(sys, "stdout", stream)
        before = len(os.listdir("/proc/self/fd"))
        text.drop_output()
        assert len(os.listdir("/proc/self/fd")) == before
        stream.write("the rest")
