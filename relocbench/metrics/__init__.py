"""Metrics of poses and of retrieval, with curves, summaries and significance. They use geometry alone and do no I/O."""

from relocbench.metrics.pose.confidence import (
    CONFIDENT,
    precision_recall,
    risk_coverage_area,
)
from relocbench.metrics.pose.curves import area_shares
from relocbench.metrics.pose.different_places import DifferentPlaces
from relocbench.metrics.pose.errors import PoseErrors, pose_errors
from relocbench.metrics.pose.failure_policy import (
    align_predictions,
    answered_pairs,
    infinite_where_failed,
    mean_over_pair_sets,
    pose_array,
)
from relocbench.metrics.pose.metric import Metric
from relocbench.metrics.pose.radius import Radius, Ratio, radius_of, radius_ratio, success_radius
from relocbench.metrics.pose.registry import METRICS, metric_named, shown_in
from relocbench.metrics.pose.scores import CORRECT, PairScores, within
from relocbench.metrics.pose.summary import (
    PairSetSummary,
    Spread,
    spread_over_seeds,
    summarize,
    summarize_scores,
    totals,
)
from relocbench.metrics.pose.virtual_correspondences import reprojection_errors
from relocbench.metrics.retrieval.chance import chance_level, chance_recall
from relocbench.metrics.retrieval.descriptors import exact_scores, rank_descriptors
from relocbench.metrics.retrieval.measures import (
    PLACE_METRICS,
    RETRIEVAL_METRICS,
    Denominator,
    RetrievalScores,
    per_group,
    score_retrieval,
    summarize_retrieval,
)
from relocbench.metrics.retrieval.plausibility import (
    check_single_positive_tables,
    single_positive_fault,
)
from relocbench.metrics.retrieval.ranking import (
    NEVER,
    Ranking,
    count_at_least,
    rank_lists,
    rank_scores,
    ranks_of_positives,
    sorted_finite,
)
from relocbench.metrics.retrieval.relevance import (
    Relevance,
    relevance_from_labels,
    relevance_from_lists,
    relevance_within,
)
from relocbench.metrics.statistics.crossed import crossed_difference
from relocbench.metrics.statistics.effective_size import MIN_EFFECTIVE
from relocbench.metrics.statistics.families import families_of, same_answers
from relocbench.metrics.statistics.intervals import (
    LEVEL,
    Difference,
    Interval,
    mean_interval,
    median_interval,
    paired_difference,
)
from relocbench.metrics.statistics.multiplicity import controlled
from relocbench.metrics.statistics.points import in_points
from relocbench.metrics.statistics.ranks import generator, rank_with_ties
from relocbench.metrics.statistics.roads import by_place

__all__ = [
    "CONFIDENT",
    "CORRECT",
    "LEVEL",
    "METRICS",
    "MIN_EFFECTIVE",
    "NEVER",
    "PLACE_METRICS",
    "RETRIEVAL_METRICS",
    "Denominator",
    "Difference",
    "DifferentPlaces",
    "Interval",
    "Metric",
    "PairScores",
    "PairSetSummary",
    "PoseErrors",
    "Radius",
    "Ranking",
    "Ratio",
    "Relevance",
    "RetrievalScores",
    "Spread",
    "align_predictions",
    "answered_pairs",
    "area_shares",
    "by_place",
    "chance_level",
    "chance_recall",
    "check_single_positive_tables",
    "controlled",
    "count_at_least",
    "crossed_difference",
    "exact_scores",
    "families_of",
    "generator",
    "in_points",
    "infinite_where_failed",
    "mean_interval",
    "mean_over_pair_sets",
    "median_interval",
    "metric_named",
    "paired_difference",
    "per_group",
    "pose_array",
    "pose_errors",
    "precision_recall",
    "radius_of",
    "radius_ratio",
    "rank_descriptors",
    "rank_lists",
    "rank_scores",
    "rank_with_ties",
    "ranks_of_positives",
    "relevance_from_labels",
    "relevance_from_lists",
    "relevance_within",
    "reprojection_errors",
    "risk_coverage_area",
    "same_answers",
    "score_retrieval",
    "shown_in",
    "single_positive_fault",
    "sorted_finite",
    "spread_over_seeds",
    "success_radius",
    "summarize",
    "summarize_retrieval",
    "summarize_scores",
    "totals",
    "within",
]
