"""Finds every force term in this folder."""

from __future__ import annotations

import importlib
import pkgutil

from spool_stream.errors import InputError

from .base import Term


def _find() -> dict[str, Term]:
    package = importlib.import_module(__package__)
    found: dict[str, Term] = {}
    for module_info in sorted(pkgutil.iter_modules(package.__path__), key=lambda info: info.name):
        if module_info.name in ("base", "registry"):
            continue
        module = importlib.import_module(f"{__package__}.{module_info.name}")
        for entry in vars(module).values():
            if isinstance(entry, type) and issubclass(entry, Term) and entry.__module__ == module.__name__:
                found[entry.name] = entry()
    return found


TERMS: dict[str, Term] = _find()


def term(name: str) -> Term:
    """Return the term called ``name``.

    Raises:
        InputError: no such term.
    """
    if name not in TERMS:
        raise InputError(f"terms: unknown force term '{name}'; known are {', '.join(TERMS)}")
    return TERMS[name]
