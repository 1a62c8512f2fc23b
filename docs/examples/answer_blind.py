"""Answers a blind export with one guess: the query camera stands FORWARD metres ahead of the keyframe.

    python3 answer_blind.py BLIND OUT --forward 1.2

A method of your own takes its place. It reads the keyframe, its depth and the query of each line of pairs/*.txt
(traversals/REF/images/CAM/REF_KEY.png, traversals/REF/depth/CAM/REF_KEY.png, traversals/QUERY/images/CAM/QUERY_KEY.png)
and writes T_query_ref, which maps points of the keyframe's camera to the query's: x right, y down, z forward, metres.
"""

import argparse
import time
from pathlib import Path


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("blind", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--forward", type=float, default=0.0)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for pairs in sorted((given.blind / "pairs").glob("*.txt")):
        poses, table = [], ["ref_timestamp_ns,query_timestamp_ns,seconds,confidence"]
        for line in pairs.read_text().splitlines():
            ref_key, query_key = line.split()[:2]
            start = time.perf_counter()
            pose = [0.0, 0.0, -given.forward, 0.0, 0.0, 0.0, 1.0]
            seconds = time.perf_counter() - start
            poses.append(" ".join([ref_key, query_key, *map(str, pose)]))
            table.append(f"{ref_key},{query_key},{seconds:.6f},0.5")
        (given.out / pairs.name).write_text("".join(f"{line}\n" for line in poses))
        (given.out / pairs.name).with_suffix(".csv").write_text("".join(f"{line}\n" for line in table))


if __name__ == "__main__":
    main()
