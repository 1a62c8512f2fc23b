"""Probing the basin of convergence: single pixels and whole poses, started at known offsets from the truth."""

from relocbench.evaluation.probe.run import ProbeOptions, ProbeReport, probe_methods

__all__ = ["ProbeOptions", "ProbeReport", "probe_methods"]
