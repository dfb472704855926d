"""Adding a law, an effect or a detector takes one file: its class is found."""

from __future__ import annotations

import importlib
import sys
from abc import ABC, abstractmethod
from pathlib import Path

import pytest
from spool_core.discovery import classes_in, modules_of

BASE = """
from abc import ABC, abstractmethod

class Law(ABC):
    @abstractmethod
    def force(self): ...
"""
FILES = {
    "base": BASE,
    "second": "from .base import Law\nclass Second(Law):\n    def force(self): ...\n",
    "first": "from .base import Law\nclass Half(Law): ...\nclass First(Half):\n    def force(self): ...\n",
    "other": "from .second import Second\nclass Unrelated: ...\n",
}


def test_concrete_classes_are_found_by_their_files_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "some_laws"
    package.mkdir()
    (package / "__init__.py").touch()
    for name, text in FILES.items():
        (package / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    try:
        base = importlib.import_module("some_laws.base").Law
        assert [entry.__name__ for entry in classes_in("some_laws", base)] == ["First", "Second"]
    finally:
        for name in [name for name in sys.modules if name.startswith("some_laws")]:
            del sys.modules[name]


def test_a_package_without_such_classes_has_none() -> None:
    class Unknown(ABC):
        @abstractmethod
        def nothing(self) -> None: ...

    assert classes_in("spool_core", Unknown) == []


def test_modules_come_in_the_order_of_their_names_without_what_all_share() -> None:
    found = [module.__name__.rpartition(".")[2] for module in modules_of("spool_core.node")]
    assert found == sorted(found)
    assert "base" not in found
