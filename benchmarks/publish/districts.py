"""Test districts whose seeds follow from a phrase: print the seed and the conditions of each.

Who chooses seeds by hand can choose those on which a method looks well. The phrase of ``docs/test-districts.md`` was
written down before the methods that are tested on it were finished, and the districts follow from it.

    python benchmarks/publish/districts.py [--next]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json

from relocbench.datasets.importers.edition.districts import districts

PHRASE = "eleven umbrellas crossed the bridge before the lamps were lit"
NEXT_PHRASE = "nine ferries waited while the lighthouse keeper learned to whistle"
"""of districts that nobody was asked yet: those of the next publication"""
COUNT = 12
__all__ = ("COUNT", "NEXT_PHRASE", "PHRASE", "districts")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--next", action="store_true", help="those of the phrase that was asked nothing yet")
    phrase = NEXT_PHRASE if parser.parse_args().next else PHRASE
    found = list(districts(phrase, COUNT))
    for district in found:
        print(f"district {district.number:2d}: seed {district.seed}, {', '.join(district.conditions)}")
    print(json.dumps({"benchmark": "districts", "phrase": phrase, "seeds": [d.seed for d in found]}))


if __name__ == "__main__":
    main()
