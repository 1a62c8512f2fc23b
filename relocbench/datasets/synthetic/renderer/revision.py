"""The revision of the renderer that a dataset was made with."""

RENDERER_REVISION = 3
"""Part of every rendered dataset's recipe; to be increased with each change that affects images, depths or drives.

Two datasets with the same recipe have the same content id, although processors differ in the last digits.
"""
