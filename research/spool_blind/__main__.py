"""Command line that writes blind cases as files: python -m spool_blind SEED... --out FOLDER."""

from __future__ import annotations

import argparse
from pathlib import Path

from spool_blind.case import HiddenCase, make, write
from spool_blind.field.case import make_field
from spool_blind.field.logged import make_logged


def main() -> None:
    """Write the cases of the seeds given, each into its own folder."""
    parser = argparse.ArgumentParser(description="Write blind cases: record.csv.gz, valve.yaml, truth.json.")
    parser.add_argument("seed", type=int, nargs="+")
    parser.add_argument("--out", type=Path, required=True, help="folder; each case gets one inside")
    parser.add_argument("--family", choices=("case", "field", "logged"), default="case")
    parser.add_argument(
        "--hidden", help="none, an effect, two joined by +, or one out of the catalogue; default: by the seed"
    )
    parser.add_argument("--factor", type=float, help="size over what is drawn; default: clear (case only)")
    parser.add_argument("--nuisances", nargs="*", help="of the measuring chain; default: by the seed (field)")
    given = parser.parse_args()
    for seed in given.seed:
        try:
            case: HiddenCase = (
                make(seed, given.hidden, factor=given.factor)
                if given.family == "case"
                else make_field(seed, given.hidden, given.nuisances)
                if given.family == "field"
                else make_logged(seed)
            )
        except KeyError as error:
            parser.error(f"--hidden {given.hidden}: {error} is no effect of the blind simulator")
        record, _ = write(case, given.out / f"{given.family}_{seed}")
        print(record, case.hidden, flush=True)


if __name__ == "__main__":
    main()
