"""Reports beside the fleet's page: replays of the newest bags of each valve in which a change was found."""

from __future__ import annotations

import hashlib
import re
from datetime import datetime
from pathlib import Path

from spool_core.errors import InputError
from spool_tools.console.outputs import check_output
from spool_tools.console.terminal import progress, warn

from spool_fleet.catalogue.manifest import FILE_NAME, Manifest

from .content import PageContent

#: Folder of the reports, beside the page.
FOLDER = "fleet_reports"


def write_reports(
    content: PageContent, out: Path, number: int, params_file: Path | None = None
) -> dict[str, str]:
    """Write the replay reports of the ``number`` newest bags of each conspicuous valve of the page ``out``.

    What is not there any more or cannot be replayed is told and left out. A valve has as many reports as
    bags in its table at most.

    Returns:
        the report of each bag, by the bag's path, relative to the folder of the page.
    """
    from spool_tools.operations.record_replay import replay_bag  # noqa: PLC0415 - slow to load

    names = {
        row.bag: report_name(f"{valve.machine} {valve.valve}", row.bag, row.start)
        for valve in content.valves
        if valve.conspicuous
        for row in valve.records.newest_bags[:number]
    }
    files = _valve_files(content.store, list(names))
    made: dict[str, str] = {}
    folder = out.absolute().parent / FOLDER
    with progress("writing reports", len(names)) as advance:
        for bag, name in names.items():
            advance(1)
            path = Path(bag)
            if not path.exists():
                warn(f"{bag}: it is not there any more, so there is no report of it")
                continue
            try:
                folder.mkdir(parents=True, exist_ok=True)
                if not _kept(folder / name):
                    replay_bag(path, files.get(bag, []), params_file=params_file, report=folder / name)
            except InputError as error:
                warn(f"{bag}: no report of it: {error}")
                continue
            except OSError as error:
                warn(f"{folder}: {error.strerror}: no reports beside the page")
                break
            made[bag] = f"{FOLDER}/{name}"
    return made


def _kept(file: Path) -> bool:
    """Return whether a report that is there already stays, since it is not to be replaced (``--force``)."""
    try:
        check_output(file, "--out")
    except InputError:
        if file.is_file() and not file.is_symlink():
            return True
        raise
    return False


def report_name(valve: str, bag: str, start: datetime) -> str:
    """Return a file name of plain letters that is another one for every bag."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", valve).strip("_")[:60]
    return f"{plain or 'valve'}_{start:%Y-%m-%d}_{hashlib.sha256(bag.encode()).hexdigest()[:8]}.html"


def _valve_files(store: Path, bags: list[str]) -> dict[str, list[str]]:
    """Return the valve files that `./spool fleet add` was given for ``bags``; the tables do not have them."""
    if not (store / FILE_NAME).is_file():
        return {}
    manifest = Manifest(store)
    try:
        return {
            bag: [f"{one.namespace}={one.valve_file}" for one in manifest.of(bag) if one.valve_file]
            for bag in bags
        }
    finally:
        manifest.close()
