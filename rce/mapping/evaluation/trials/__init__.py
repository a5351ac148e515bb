"""Trials of mappers on recordings: accuracy by relations of poses, degraded odometry, cost, and endless runs."""

from rce.mapping.evaluation.trials.endless import Endless, endless, flatness
from rce.mapping.evaluation.trials.odometry import Odometry, with_odometry
from rce.mapping.evaluation.trials.relations import Error, Relations, error_of, read_relations, relations_of
from rce.mapping.evaluation.trials.trial import Trial, run

__all__ = [
    "Endless",
    "Error",
    "Odometry",
    "Relations",
    "Trial",
    "endless",
    "error_of",
    "flatness",
    "read_relations",
    "relations_of",
    "run",
    "with_odometry",
]
