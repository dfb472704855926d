"""A library that is missing or too old: one line that names it, and advice that works."""

from __future__ import annotations

import importlib
import shlex
import sys
from pathlib import Path

import pytest
from spool_core import errors as libraries
from spool_core.errors import how_to_install, libraries_reported, unmet_library


@pytest.fixture(name="old_pydantic")
def _old_pydantic(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The pydantic of Debian 12, as Python sees it."""
    described = tmp_path / "pydantic-1.10.4.dist-info"
    described.mkdir()
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: pydantic\nVersion: 1.10.4\n", "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))


@pytest.mark.usefixtures("old_pydantic")
def test_an_old_library_is_named_with_its_version_and_the_one_needed() -> None:
    error = ImportError("cannot import name 'TypeAdapter' from 'pydantic'", name="pydantic")
    said = unmet_library(error)
    assert said is not None
    assert said.startswith("pydantic 1.10.4 is too old, pydantic>=2.0 is needed: ")


def test_a_missing_library_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, libraries_reported("estimator"):
        importlib.import_module("no_such_library_of_ours")
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("estimator: the Python package no_such_library_of_ours is missing: ")


def test_a_module_of_the_suite_that_fails_keeps_its_traceback() -> None:
    with pytest.raises(ImportError), libraries_reported("estimator"):
        importlib.import_module("spool_core.no_such_module")


def test_pip_is_advised_where_it_may_install_and_else_an_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Debian and Ubuntu mark their Python as managed by the system (PEP 668)."""
    monkeypatch.setattr(libraries.sysconfig, "get_path", lambda _name: str(tmp_path))
    command = how_to_install("pydantic>=2.0").removeprefix("type ")
    assert shlex.split(command) == [sys.executable, "-m", "pip", "install", "pydantic>=2.0"]
    (tmp_path / "EXTERNALLY-MANAGED").touch()
    monkeypatch.setattr(sys, "base_prefix", sys.prefix)
    assert "virtual environment" in how_to_install("pydantic>=2.0")
    monkeypatch.setattr(sys, "base_prefix", "/usr")
    assert how_to_install("pydantic>=2.0").startswith("type ")
