"""Make recordings with known poses from small sets of photographs that were published for other purposes.

    python tools/real_sets KIND OUT FOLDER ...

``python tools/real_sets KIND --help`` says what KIND takes, what it makes up, and what is exact. OUT/map and the other
folders in OUT are generic folders for ``relocbench build-dataset generic``: keyframes, which stand far from each other,
and queries. An OUT that exists already is refused.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import homographies
import shifted_images
import stereo_pairs
import still_camera
from generic_folder import write

from relocbench.errors import DatasetError, RelocbenchError

KINDS = {
    "still-camera": still_camera,
    "shifted-images": shifted_images,
    "stereo-pairs": stereo_pairs,
    "homographies": homographies,
}


def main() -> int:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("real_sets", description=__doc__, formatter_class=raw)
    kinds = parser.add_subparsers(required=True, metavar="KIND")
    for name, module in KINDS.items():
        assert module.__doc__ is not None
        kind = kinds.add_parser(
            name, help=module.__doc__.splitlines()[0], description=module.__doc__, formatter_class=raw
        )
        kind.add_argument("out", type=Path, metavar="OUT")
        module.add_arguments(kind)
        kind.set_defaults(made=module.made)
    options = parser.parse_args()
    try:
        if options.out.exists():
            raise DatasetError("exists already; expected a folder that is to be made", options.out)
        write(options.out, options.made(options))
    except RelocbenchError as bad:
        print(bad, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
