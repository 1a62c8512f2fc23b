"""A tracker as a program of its own: answers every query with one fixed motion.

It speaks relocbench's line protocol and needs nothing but Python's standard library; a C++ tracker does the same
with its own JSON library. Try it with

    relocbench check-method "subprocess:python3 docs/examples/constant_velocity.py --forward 1.2"
"""

import argparse
import json
import sys


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--forward", type=float, default=0.0, help="metres that the query is ahead of the keyframe")
    forward = parser.parse_args().forward

    for line in sys.stdin:
        message = json.loads(line)
        if message["type"] == "stop":
            break
        if message["type"] in ("start", "reference"):
            # A real tracker loads message["image"], and message["depth"] or message["points"], here.
            answer = {"type": "ready", "id": message["id"]}
        else:
            # T_query_ref as tx ty tz qx qy qz qw: a query that is ahead sees the keyframe's points nearer by as much.
            pose = [0, 0, -forward, 0, 0, 0, 1]
            answer = {"type": "result", "id": message["id"], "pose": pose, "confidence": 1.0}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
