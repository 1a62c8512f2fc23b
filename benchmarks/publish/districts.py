"""Test districts whose seeds follow from a phrase: print the seed and the conditions of each.

Who chooses seeds by hand can choose those on which a method looks well. The phrase of ``docs/test-districts.md`` was
written down before the methods that are tested on it were finished, and the districts follow from it.

    python benchmarks/publish/districts.py

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json

from relocbench.datasets.importers.edition.districts import districts

PHRASE = "eleven umbrellas crossed the bridge before the lamps were lit"
COUNT = 12
__all__ = ("COUNT", "PHRASE", "districts")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    found = list(districts(PHRASE, COUNT))
    for district in found:
        print(f"district {district.number:2d}: seed {district.seed}, {', '.join(district.conditions)}")
    print(json.dumps({"benchmark": "districts", "phrase": PHRASE, "seeds": [d.seed for d in found]}))


if __name__ == "__main__":
    main()
