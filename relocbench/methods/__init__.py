"""Finding and configuring methods, and talking to methods that are programs."""

from relocbench.methods.discovery import (
    ENTRY_POINT_GROUP,
    KINDS,
    RETRIEVERS,
    SUBPROCESS,
    TRACKERS,
    MethodKind,
    MethodSpec,
    distribution_version,
    installed_methods,
    kind_of,
    method_class,
    parameters_of,
    parse_method,
    parse_methods,
    target_of,
)
from relocbench.methods.parameters import Parameter

__all__ = [
    "ENTRY_POINT_GROUP",
    "KINDS",
    "RETRIEVERS",
    "SUBPROCESS",
    "TRACKERS",
    "MethodKind",
    "MethodSpec",
    "Parameter",
    "distribution_version",
    "installed_methods",
    "kind_of",
    "method_class",
    "parameters_of",
    "parse_method",
    "parse_methods",
    "target_of",
]
