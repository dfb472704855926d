"""Remedies: what the kinds and causes of events mean on the machine, and what to do (``causes.yaml``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import yaml


@dataclass(frozen=True, slots=True)
class Remedy:
    """What a cause means on the machine and what to do about it."""

    meaning: str
    remedy: str


@lru_cache(maxsize=1)
def remedies() -> Mapping[str, Remedy]:
    """Return the shipped table of causes (``causes.yaml``), by ``kind/cause`` or ``kind``."""
    table = yaml.safe_load((files(__package__) / "causes.yaml").read_text(encoding="utf-8"))
    return {name: Remedy(**entry) for name, entry in table.items()}


def remedy(kind: str, cause: str = "") -> Remedy | None:
    """Return what to do about ``cause`` of an event ``kind``, the kind's own where the cause has none."""
    table = remedies()
    return table.get(f"{kind}/{cause}") or table.get(kind)


def advice(kind: str, cause: str = "") -> str:
    """Return what to do, empty where nothing is known."""
    found = remedy(kind, cause)
    return found.remedy if found else ""
