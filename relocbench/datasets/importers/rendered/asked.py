"""Which traversals of a rendered dataset make pair sets."""

from __future__ import annotations

from typing import TYPE_CHECKING

from relocbench.errors import ConfigError

if TYPE_CHECKING:
    from relocbench.datasets.importers.rendered.dataset import Options
    from relocbench.datasets.synthetic.jobs.plan import TraversalPlan


def asked(plans: list[TraversalPlan], options: Options) -> list[tuple[TraversalPlan, TraversalPlan]]:
    """The (reference, query) traversals of every pair set.

    The reference's condition is also a query condition: in its second traversal, or else in the reference itself.
    """
    found = []
    for split in dict.fromkeys(plan.split for plan in plans):
        members = [plan for plan in plans if plan.split == split]
        references = members if options.reference == "all" else members[:1]
        for reference in references:
            for query in members:
                itself = reference is query
                alone = options.traversals == 1
                if options.pair_rule == "step":
                    wanted = itself
                elif options.pair_rule == "nearest":
                    wanted = not itself
                else:
                    wanted = not itself or alone
                if wanted:
                    found.append((reference, query))
    if not found:
        raise ConfigError("--pair-rule nearest needs a second traversal; name more conditions or raise --traversals")
    return found
