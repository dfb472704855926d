"""Command line that writes field cases as files: python -m spool_blind.field SEED... --out FOLDER."""

from __future__ import annotations

import argparse
from pathlib import Path

from spool_blind.field.case import make_field, write_field


def main() -> None:
    """Write the field cases of the seeds given, each into its own folder."""
    parser = argparse.ArgumentParser(description="Write field cases: record.csv.gz, valve.yaml, truth.json.")
    parser.add_argument("seed", type=int, nargs="+")
    parser.add_argument("--out", type=Path, required=True, help="folder; each case gets one inside")
    parser.add_argument("--hidden", help="none, an effect, two joined by +, or a law; default: by the seed")
    parser.add_argument("--nuisances", nargs="*", help="names of what the chain does; default: by the seed")
    given = parser.parse_args()
    for seed in given.seed:
        case = make_field(seed, given.hidden, given.nuisances)
        record, _ = write_field(case, given.out / f"field_{seed}")
        print(record, case.hidden, *(one.id for one in case.nuisances), flush=True)


if __name__ == "__main__":
    main()
