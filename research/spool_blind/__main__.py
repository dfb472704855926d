"""Command line that writes cases as files: python -m spool_blind SEED... --out FOLDER."""

from __future__ import annotations

import argparse
from pathlib import Path

from spool_blind.field.case import make_field
from spool_blind.field.logged import make_logged
from spool_blind.files import write


def main() -> None:
    """Write the cases of the seeds given, each into its own folder."""
    parser = argparse.ArgumentParser(description="Write cases: record.csv.gz, valve.yaml, truth.json.")
    parser.add_argument("seed", type=int, nargs="+")
    parser.add_argument("--out", type=Path, required=True, help="folder; each case gets one inside")
    parser.add_argument("--family", choices=("field", "logged"), default="field")
    parser.add_argument(
        "--hidden", help="none, an effect, two joined by +, or a law of no catalogue; default: by the seed"
    )
    parser.add_argument("--nuisances", nargs="*", help="of the measuring chain; default: by the seed")
    given = parser.parse_args()
    for seed in given.seed:
        try:
            logged = given.family == "logged"
            case = make_logged(seed) if logged else make_field(seed, given.hidden, given.nuisances)
        except KeyError as error:
            parser.error(f"{error} is no effect or nuisance that the second simulator has")
        record, _ = write(case, given.out / f"{given.family}_{seed}")
        print(record, case.hidden, flush=True)


if __name__ == "__main__":
    main()
