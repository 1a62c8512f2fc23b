"""The process in which a method of another package is imported to learn what has to be known of it before a run."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from relocbench.evaluation.isolation.isolated_process import Connection, serve
from relocbench.execution import Sandbox
from relocbench.methods import MethodKind, MethodSpec, parse_method


@dataclass(frozen=True)
class Configuration:
    """What a user gives of one method, and in whose sandbox it is read."""

    label: str
    """the method as the user names it, for messages"""
    settings: tuple[str, ...]
    seed: int
    kind: MethodKind
    sandbox: Sandbox

    def parse(self) -> MethodSpec:
        return parse_method(self.label, self.settings, self.seed, self.kind)


@dataclass(frozen=True)
class Reported:
    """What the process of a method reports of it, of the right types and else unchecked."""

    parameters: dict[str, Any]
    uses_times: bool
    assumes: str
    files: dict[str, str]


def main(descriptor: int) -> None:
    """Report what a method needs, over a socket, in a process of its own."""
    serve(descriptor, _made)


def _made(configuration: Configuration, connection: Connection) -> tuple[object, dict[str, Any]]:
    spec = configuration.parse()
    parameters = json.loads(json.dumps(dict(spec.parameters), default=str))
    return object(), asdict(Reported(parameters, spec.uses_times(), spec.assumes(), spec.files()))
