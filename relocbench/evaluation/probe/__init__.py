"""How far off may a method start? Single pixels and whole poses, started known offsets off the truth."""

from relocbench.evaluation.probe.run import ProbeOptions, ProbeReport, probe_methods

__all__ = ["ProbeOptions", "ProbeReport", "probe_methods"]
