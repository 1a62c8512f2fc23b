"""What the renderer shows, in few numbers: ``from rendered_summary import GOLDEN, summary``.

``python tests/support/rendered_summary.py`` writes the golden values anew, after ``RENDERER_REVISION`` was raised.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from relocbench.datasets.core.pairfile import TRUTH_DECIMALS, pose_fields
from relocbench.datasets.synthetic.conditions.presets import conditions_of
from relocbench.datasets.synthetic.drives.drive import DriveStyle
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.plan import AskedDrives, make_plans
from relocbench.datasets.synthetic.renderer.revision import RENDERER_REVISION
from relocbench.geometry import Camera, make_transform, so3_exp
from relocbench.progress import Silent

GOLDEN = Path(__file__).with_name("rendered_summary.json")
_CAMERA = Camera("pinhole", 96, 72, 60.0, 60.0, 47.5, 35.5)
_BLOCKS = (6, 4)
_CONDITIONS = ("Sunny", "Rain", "Snow", "Night")


def summary() -> dict[str, Any]:
    """Revision, and for each condition the second pose of a drive, mean colours of blocks and median depths of them."""
    plans = make_plans(
        AskedDrives(("test",), conditions_of(_CONDITIONS, {}, None, 0), 1, 3),
        3,
        DriveStyle(heading_deg=4.0),
        extent_m=190.0,
        reporter=Silent(),
    )
    forward = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # the camera looks along the rig's x
    frames = {}
    for plan in plans:
        T_world_rig = plan.drive.T_world_rig[1]
        T_world_cam = T_world_rig @ make_transform(forward @ so3_exp([-0.1, 0.0, 0.0]), [0.0, 0.0, 1.6])
        frame = scenes.renderer(plan.place, plan.condition.factors, plan.moving[1]).render(_CAMERA, T_world_cam, 11)
        blocks = cv2.resize(frame.rgb.astype(np.float64), _BLOCKS, interpolation=cv2.INTER_AREA)
        rows, columns = _CAMERA.height // _BLOCKS[1], _CAMERA.width // _BLOCKS[0]
        tiles = frame.depth.reshape(_BLOCKS[1], rows, _BLOCKS[0], columns).swapaxes(1, 2).reshape(-1, rows * columns)
        frames[plan.name] = {
            "pose": [float(value) for value in pose_fields(T_world_rig, TRUTH_DECIMALS)],
            "colour": np.round(blocks, 1).ravel().tolist(),
            "depth_m": np.round(np.median(tiles, axis=1).astype(np.float64), 3).tolist(),
        }
    return {"revision": RENDERER_REVISION, "frames": frames}


if __name__ == "__main__":
    text = json.dumps(summary(), indent=1)
    line_a_list = re.sub(r"\[[^]]*\]", lambda found: json.dumps(json.loads(found[0])), text)
    GOLDEN.write_text(line_a_list + "\n", encoding="utf-8")
