from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest
from spool_core.system import others_may_write, private_file, private_folder


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_what_is_made_is_the_owner_s_alone(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        private_folder(tmp_path / "a" / "b")
        private_file(tmp_path / "a" / "b" / "c")
    finally:
        os.umask(before)
    assert [mode(tmp_path / path) for path in ("a", "a/b", "a/b/c")] == [0o700, 0o700, 0o600]


def test_what_is_there_is_restricted_and_what_is_above_it_is_not(tmp_path: Path) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a").chmod(0o755)
    (tmp_path / "a" / "b").chmod(0o755)
    private_folder(tmp_path / "a" / "b")
    assert [mode(tmp_path / "a"), mode(tmp_path / "a" / "b")] == [0o755, 0o700]


def test_a_file_keeps_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("content", "utf-8")
    private_file(tmp_path / "a")
    assert (tmp_path / "a").read_text("utf-8") == "content"
    assert mode(tmp_path / "a") == 0o600


@pytest.mark.parametrize(
    ("above", "folder", "said"),
    [
        (0o700, 0o700, None),
        (0o755, 0o755, None),
        (0o755, 0o777, "everybody may write in"),
        (0o777, 0o755, "everybody may write in"),
        (0o1777, 0o755, None),  # as /tmp: nobody may rename what is another's
        (0o755, 0o1777, "everybody may write in"),
    ],
)
def test_who_may_write_follows_from_the_folder_and_all_above_it(
    tmp_path: Path, above: int, folder: int, said: str | None
) -> None:
    path = tmp_path / "above" / "folder"
    path.mkdir(parents=True)
    path.chmod(folder)
    path.parent.chmod(above)
    found = others_may_write(path)
    assert found == said if said is None else said in (found or "")
    assert others_may_write(path / "not there yet") == found or folder & 0o1000


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize(
    ("owner", "mode", "said"),
    [(54321, 0o755, "{} belongs to user 54321"), (0, 0o775, "group 54321 may write in {}")],
)
def test_a_folder_of_others_is_not_trusted(tmp_path: Path, owner: int, mode: int, said: str) -> None:
    path = tmp_path / "folder"
    path.mkdir()
    os.chown(path, owner, 54321)
    path.chmod(mode)
    assert others_may_write(path) == said.format(path)
