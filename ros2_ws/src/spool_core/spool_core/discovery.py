"""Discovery of what the modules of a package define: adding one takes a new file and nothing else.

Another distribution adds modules by entry points whose group is the name of the package, e.g.
``entry_points={"spool_sim.terms": ["my_law = my_package.my_law"]}``.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

from spool_core.errors import InputError, add_on_missing

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Found = TypeVar("Found")


def classes_in(package: str, base: type[Any]) -> list[type[Any]]:
    """Return the concrete classes derived from ``base`` that the modules of ``package`` define.

    They come in the order of the modules' names. The module ``base`` is left out: it holds what all share.
    """
    return [
        entry
        for module in modules_of(package)
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
        entry for module in modules_of(package) for entry in vars(module).values() if isinstance(entry, kind)
    ]
    return list({id(entry): entry for entry in found}.values())


def offered(group: str) -> list[EntryPoint]:
    """Return the entry points of ``group`` of all installed distributions, by name."""
    from importlib.metadata import entry_points  # noqa: PLC0415 - loads email and zipfile

    return sorted(entry_points(group=group), key=lambda one: one.name)


def modules_of(package: str, suffix: str = "") -> list[ModuleType]:
    """Return the modules of ``package`` whose names end with ``suffix``, then those that others add.

    Raises:
        InputError: a module of another distribution cannot be loaded; both are named.
    """
    names = {module.name for module in pkgutil.iter_modules(importlib.import_module(package).__path__)}
    own = sorted(name for name in names - {"base"} if name.endswith(suffix))
    found = [importlib.import_module(f"{package}.{name}") for name in own]
    for entry in offered(package):
        name = entry.dist.name if entry.dist is not None else "a distribution without a name"
        try:
            found.append(importlib.import_module(entry.value))
        except Exception as error:
            raise InputError(
                f"{name} adds {entry.value} to {package}, which cannot be loaded "
                f"({type(error).__name__}: {error}): repair or uninstall {name}"
            ) from error
    return found


def from_add_on(package: str, name: str) -> Any:
    """Return what the add-on ``package`` offers as the entry point ``name`` of the group of its name.

    Raises:
        InputError: the add-on is missing.
    """
    from importlib.metadata import entry_points  # noqa: PLC0415 - as above

    for entry in entry_points(group=package, name=name):
        return entry.load()
    raise InputError(add_on_missing(package))
