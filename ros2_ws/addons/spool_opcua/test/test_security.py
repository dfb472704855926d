"""Security folder of the OPC UA server: what it takes, and what it refuses in one line."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from spool_core.errors import InputError
from spool_core.opcua_folder import CERTIFICATE, KEY, OPERATORS, TRUSTED, keep_operator, make_server
from spool_opcua.security import Security


@pytest.fixture(name="folder")
def _folder(tmp_path: Path) -> Path:
    make_server(tmp_path / "security")
    return tmp_path / "security"


def test_an_operator_is_known_by_the_password_alone(folder: Path) -> None:
    keep_operator(folder, "anna", "first secret")
    keep_operator(folder, "anna", "second secret")
    keep_operator(folder, "jan", "another secret")
    kept = Security.read(folder).operators
    assert set(kept) == {"anna", "jan"}
    assert kept["anna"].fits("second secret")
    assert not kept["anna"].fits("first secret")
    assert "secret" not in (folder / OPERATORS).read_text("utf-8")


def test_a_new_password_renews_no_certificate(folder: Path) -> None:
    before = (folder / KEY).read_bytes()
    assert not make_server(folder)
    assert (folder / KEY).read_bytes() == before


@pytest.mark.parametrize("name", [KEY, OPERATORS])
def test_secrets_that_others_can_read_are_refused(folder: Path, name: str) -> None:
    keep_operator(folder, "anna", "a good secret")
    assert stat.S_IMODE((folder / name).stat().st_mode) == 0o600
    (folder / name).chmod(0o644)
    with pytest.raises(InputError, match=rf"{name}: others can read it .mode 644.: chmod 600"):
        Security.read(folder)


def test_what_cannot_be_used_is_named(folder: Path) -> None:
    with pytest.raises(InputError, match="too short"):
        keep_operator(folder, "anna", "short")
    with pytest.raises(InputError, match="operator"):
        keep_operator(folder, "anna\n", "a good secret")
    (folder / OPERATORS).write_text("[1]", "utf-8")
    (folder / OPERATORS).chmod(0o600)
    with pytest.raises(InputError, match="not a list of operators"):
        Security.read(folder)
    (folder / OPERATORS).unlink()
    (folder / TRUSTED / "client.pem").write_text("-----BEGIN nothing", "utf-8")
    with pytest.raises(InputError, match="not a certificate"):
        Security.read(folder)
    with pytest.raises(InputError, match="make it with"):
        Security.read(folder / "none")


@pytest.mark.parametrize("name", [OPERATORS, CERTIFICATE])
def test_a_disk_that_fails_is_no_reason_to_make_it_again(
    folder: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep_operator(folder, "anna", "first secret")

    def failing(path: Path, **_: object) -> str:
        raise OSError(5, "Input/output error", str(path))

    monkeypatch.setattr(Path, "read_text" if name == OPERATORS else "read_bytes", failing)
    with pytest.raises(InputError, match=f"{name}: .*Input/output error$"):
        Security.read(folder)
