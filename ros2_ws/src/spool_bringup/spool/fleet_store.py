"""Fleet: many bags of many valves, catalogued, analysed and asked."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spool_core.system import expanded
from spool_core.uncertainty import as_json

from spool.errors import one_error

if TYPE_CHECKING:
    import pandas as pd


class Fleet:
    """Store of a fleet; ``store`` is its folder.

    Its files are Parquet tables, the same that ``spool fleet`` makes.
    """

    def __init__(self, store: Path) -> None:
        self.store = store

    @one_error
    def add(
        self, folders: str | Path | Iterable[str | Path], pattern: str | None = None, valve: str = ""
    ) -> str:
        """Add the bags in folders to the catalogue, and return what was added, in a line.

        Args:
            folders: with bags in and below them.
            pattern: how the paths name the bags, such as ``"{machine}/{date}/{valve}"``.
            valve: name or file where bags do not describe their valve.

        Raises:
            InputError: a folder, the pattern or the valve cannot be used.
        """
        from spool_fleet.operations import add_to_store  # noqa: PLC0415 - slow to load, as below

        paths = [expanded(one) for one in ([folders] if isinstance(folders, (str, Path)) else folders)]
        added = add_to_store(self.store, paths, pattern, None, valve, None)
        return (
            f"{added.new} bags added or changed, {added.unchanged} known already; "
            f"{added.damaged} damaged, {added.duplicates} duplicates"
        )

    @one_error
    def run(self, analysis: str = "fit,monitor", workers: int | None = None) -> str:
        """Analyse the bags that are not analysed yet, and return what was done and found, in lines.

        In a script, call it below ``if __name__ == "__main__":``; it starts processes.

        Args:
            analysis: ``fit``, ``monitor``, ``gap``, ``features``, separated by commas.
            workers: processes; default: one for each processor.

        Raises:
            InputError: no store, or no such analysis.
        """
        from spool_fleet.operations import run_over_store  # noqa: PLC0415

        result, lines = run_over_store(self.store, analysis, workers, None)
        done = f"{result.bags} bags analysed, {len(result.failed)} of {result.analyses} analyses failed"
        return "\n".join([done, *lines])

    @one_error
    def query(self, sql: str) -> list[dict[str, Any]]:
        """Return the rows that one SELECT over the tables finds, as ``fleet query --json`` writes them.

        Raises:
            InputError: no store, or the SQL cannot be answered.
        """
        from spool_fleet.operations import answer  # noqa: PLC0415

        rows: list[dict[str, Any]] = as_json(answer(self.store, sql, None, "", "", ""))
        return rows

    @one_error
    def to_frame(self, sql: str) -> pd.DataFrame:
        """Return what ``query`` does as a pandas table.

        Raises:
            InputError: as ``query``, or pandas is not installed.
        """
        import pandas as pd  # noqa: PLC0415 - an extra

        return pd.DataFrame(self.query(sql))

    @one_error
    def page(self, out: str | Path) -> None:
        """Write the page of the fleet: a light for each valve, what changed, courses of the parameters.

        Raises:
            InputError: no store, or the page exists or cannot be written.
        """
        from spool.results import keeping_backend  # noqa: PLC0415

        with keeping_backend():
            from spool_fleet.operations import write_page  # noqa: PLC0415

            write_page(self.store, Path(out), 0)

    def __repr__(self) -> str:
        return f"Fleet({str(self.store)!r})"


@one_error
def fleet(store: str | Path) -> Fleet:
    """Return the fleet in the folder ``store``, which ``add`` makes if it is missing.

    Raises:
        InputError: ``store`` is no path.
    """
    return Fleet(expanded(store))
