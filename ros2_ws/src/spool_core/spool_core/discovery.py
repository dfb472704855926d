"""Discovery of what the modules of a package define: adding one takes a new file and nothing else."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from types import ModuleType
from typing import Any, TypeVar

Found = TypeVar("Found")


def classes_in(package: str, base: type[Any]) -> list[type[Any]]:
    """Return the concrete classes derived from ``base`` that the modules of ``package`` define.

    They come in the order of the modules' names. The module ``base`` is left out: it holds what all share.
    """
    return [
        entry
        for module in _modules(package)
        for entry in vars(module).values()
        if isinstance(entry, type)
        and issubclass(entry, base)
        and entry.__module__ == module.__name__
        and not inspect.isabstract(entry)
    ]


def objects_in(package: str, kind: type[Found]) -> list[Found]:
    """Return the objects of ``kind`` that the modules of ``package`` declare; order as of ``classes_in``.

    One that several modules import comes once.
    """
    found = [
        entry for module in _modules(package) for entry in vars(module).values() if isinstance(entry, kind)
    ]
    return list({id(entry): entry for entry in found}.values())


def _modules(package: str) -> list[ModuleType]:
    folder = importlib.import_module(package).__path__
    names = {module.name for module in pkgutil.iter_modules(folder)} - {"base"}
    return [importlib.import_module(f"{package}.{name}") for name in sorted(names)]
