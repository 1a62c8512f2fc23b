"""A small dataset with queries from another camera than its keyframes: ``from two_cameras import make_two_cameras``."""

from __future__ import annotations

from pathlib import Path

from built_once import built_once
from small_dataset import START_NS, STEP_NS, render, small_camera, small_pose

from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import pair_set_name
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.schema import CameraEntry, Condition, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.pairs.writing import write_pair_set
from relocbench.execution import Run
from relocbench.geometry import invert, make_transform, so3_exp
from relocbench.progress import Silent

RIG = {
    "near": (small_camera(96, 72), make_transform(so3_exp([0.0, 0.0, 0.0]), [0.0, 0.0, 0.0])),
    "far": (small_camera(80, 60), make_transform(so3_exp([0.0, 0.1, 0.0]), [0.3, -0.1, 0.1])),
}
"""camera and ``T_rig_cam``; the cameras differ in size"""
SAME, ACROSS, BACK = "summer__winter__near", "summer__winter__near__far", "summer__summer__far__near"


@built_once(Dataset)
def make_two_cameras(root: Path, *, frames: int = 4) -> None:
    """Two traversals with both cameras: sets of one camera, across cameras, and across cameras of one traversal."""
    writer = DatasetWriter(root, "two", {"kind": "two", "frames": frames}, licence="CC0-1.0")
    poses = {
        name: {START_NS + 10**15 * k + STEP_NS * i: small_pose(i, lateral_m=0.1 * k) for i in range(frames)}
        for k, name in enumerate(("summer", "winter"))
    }
    for name, of in poses.items():
        entries = {c: CameraEntry.of(camera, T_rig_cam, (0.01, 0.0, 0.0)) for c, (camera, T_rig_cam) in RIG.items()}
        writer.traversal(TraversalFile(name=name, condition=Condition(season=name), cameras=entries), of)
        for time, T_world_rig in of.items():
            for c, (camera, T_rig_cam) in RIG.items():
                image, depth = render(camera, T_world_rig @ T_rig_cam)
                writer.image(name, c, time, image)
                writer.depth(name, c, time, depth)
    job = Build(writer, ImportOptions(correspondences=40), Silent(), Run())
    names = []
    for reference, query, *cameras in (
        ("summer", "winter", "near", "near"),
        ("summer", "winter", "near", "far"),
        ("summer", "summer", "far", "near"),
    ):
        pairs = []
        for ref, time in zip(poses[reference], poses[query], strict=True):
            T_world_ref = poses[reference][ref] @ RIG[cameras[0]][1]
            T_world_query = poses[query][time] @ RIG[cameras[1]][1]
            pairs.append(Pair(ref, time, invert(T_world_query) @ T_world_ref, source="poses of the traversals"))
        write_pair_set(job, reference, query, cameras[0], pairs, cameras[1])
        names.append(pair_set_name(reference, query, *cameras))
    writer.finish({"train": names})
