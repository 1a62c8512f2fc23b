"""Whether a tracker's answer keeps the contract, for tests of trackers."""

from __future__ import annotations

from relocbench.tracking import ContractFault, plain_result


def fault_of(result: object) -> str | None:
    """The reason why ``result`` breaks the contract, or None if it does not."""
    try:
        plain_result(result)
    except ContractFault as fault:
        return str(fault)
    return None
