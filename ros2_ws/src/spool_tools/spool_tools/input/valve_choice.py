"""Choice of the valve file for each valve of a record, and where it came from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from spool_core.errors import InputError
from spool_core.text.suggestion import did_you_mean
from spool_sim.valve.description import Valve, find_valve

from .bag_valve import recorded_valve
from .record_loading import Source
from .record_names import split_name
from .table_source import TableSource

DEFAULT_VALVE = "4weh10_soft"


@dataclass(frozen=True, slots=True)
class ChosenValve:
    """Valve description that was chosen.

    Attributes:
        valve: the description.
        source: ``given`` on the command line, ``recorded`` in the bag, or ``assumed``.
        file: what was given or assumed, empty where it was recorded.
    """

    valve: Valve
    source: str
    file: str = ""

    def sentence(self) -> str:
        """Return which valve it is and why, for people."""
        why = {
            "given": f"by --valve {self.file}",
            "recorded": "as the bag describes it",
            "assumed": f"ASSUMED to be {self.file}",
        }[self.source]
        return f"valve {self.valve.id} ({self.valve.natural_frequency:.3g} Hz), {why}"

    def warning(self, name: str) -> str:
        """Return what to do about an assumption, empty where none was made."""
        if self.source != "assumed":
            return ""
        return (
            f"{name}: the record does not describe its valve and --valve is not given: {self.file} "
            f"({self.valve.moving_mass:g} kg, {self.valve.natural_frequency:.3g} Hz) is assumed; stiffness, "
            "damping and friction scale with its moving_mass: give --valve FILE"
        )


def choose_valves(source: Source, names: Sequence[str], given: Sequence[str]) -> dict[str, ChosenValve]:
    """Return the description of each valve of ``source``.

    Args:
        source: the record.
        names: of its valves.
        given: ``FILE`` once for all or once for each in order of name, or ``NAME=FILE`` for some or all.

    Raises:
        InputError: no such file or valve, one given twice, or a number that fits neither one nor each.
    """
    pairs = [split_name(text) for text in given]
    named = {name: file for name, file in pairs if name}
    unnamed = [file for name, file in pairs if not name]
    if named and unnamed:
        raise InputError(f"--valve {unnamed[0]}: others have a name: write NAME={unnamed[0]} as well")
    for name, file in named.items():
        if name not in names:
            raise InputError(
                f"--valve {name}={file}: {source.path} has no valve {name}: it has {', '.join(names)}"
                f"{did_you_mean(name, names)}"
            )
        if sum(name == other for other, _ in pairs) > 1:
            raise InputError(f"--valve {name}=...: it stands there twice: give it once")
    if len(unnamed) == 1:
        unnamed = unnamed * len(names)
    elif unnamed and len(unnamed) != len(names):
        raise InputError(
            f"--valve was given {len(unnamed)} times, the bag holds {', '.join(names)}: "
            "give it once for all, or NAME=FILE for each"
        )
    files = named or dict(zip(names, unnamed, strict=False))
    return {
        name: ChosenValve(find_valve(files[name]), "given", files[name])
        if name in files
        else _without_file(source, name)
        for name in names
    }


def _without_file(source: Source, name: str) -> ChosenValve:
    recorded = None if isinstance(source, TableSource) else recorded_valve(source, name)
    if recorded is not None:
        return ChosenValve(recorded, "recorded")
    return ChosenValve(find_valve(DEFAULT_VALVE), "assumed", DEFAULT_VALVE)
