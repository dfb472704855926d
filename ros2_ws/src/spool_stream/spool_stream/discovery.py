"""Finds the classes that the modules of a package define: adding one takes a new file and nothing else."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from typing import Any


def classes_in(package: str, base: type[Any]) -> list[type[Any]]:
    """Return the concrete classes derived from ``base`` that the modules of ``package`` define.

    They come in the order of the modules' names. The modules ``base`` and ``registry`` are left out: they may
    be the ones that ask.
    """
    found: list[type[Any]] = []
    folder = importlib.import_module(package).__path__
    for name in sorted(module.name for module in pkgutil.iter_modules(folder)):
        if name in ("base", "registry"):
            continue
        module = importlib.import_module(f"{package}.{name}")
        found += [
            entry
            for entry in vars(module).values()
            if isinstance(entry, type)
            and issubclass(entry, base)
            and entry.__module__ == module.__name__
            and not inspect.isabstract(entry)
        ]
    return found
