"""Which renderer a rendered dataset was made by."""

RENDERER_REVISION = 1
"""Part of every rendered dataset's recipe: raise it with each change that shows in pictures, depths or drives.

Two datasets of one recipe ask the same question, although processors differ in the last digits of what they render.
"""
