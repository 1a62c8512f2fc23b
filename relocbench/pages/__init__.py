"""Pages for people: templates with their sentences, and what keeps foreign text from acting in them.

A template (``*.md.j2``, ``*.html.j2``) lies beside the module that fills it, or in a folder there: the module computes
the values, the template holds the prose.
"""

from relocbench.pages.templates import render

__all__ = ["render"]
