"""Finding and configuring methods, and talking to methods that are programs."""

from relocbench.methods.discovery import (
    KINDS,
    RETRIEVERS,
    SUBPROCESS,
    TRACKERS,
    MethodKind,
    distribution_version,
    installed_methods,
    kind_of,
    method_class,
    parameters_of,
)
from relocbench.methods.specs import MethodSpec, parse_method, parse_methods, target_of

__all__ = [
    "KINDS",
    "RETRIEVERS",
    "SUBPROCESS",
    "TRACKERS",
    "MethodKind",
    "MethodSpec",
    "distribution_version",
    "installed_methods",
    "kind_of",
    "method_class",
    "parameters_of",
    "parse_method",
    "parse_methods",
    "target_of",
]
