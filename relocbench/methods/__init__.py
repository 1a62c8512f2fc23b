"""Finding, configuring and speaking to methods."""

from relocbench.methods.discovery import (
    ENTRY_POINT_GROUP,
    SUBPROCESS,
    MethodSpec,
    Parameter,
    distribution_version,
    installed_methods,
    method_class,
    parameters_of,
    parse_method,
    parse_methods,
)

__all__ = [
    "ENTRY_POINT_GROUP",
    "SUBPROCESS",
    "MethodSpec",
    "Parameter",
    "distribution_version",
    "installed_methods",
    "method_class",
    "parameters_of",
    "parse_method",
    "parse_methods",
]
