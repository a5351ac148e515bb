"""How good mappers are on recordings, and what they cost: relations of poses, worse odometry, and endless runs."""

from rce.mapping.trials.endless import Endless, endless, flatness
from rce.mapping.trials.odometry import Odometry, with_odometry
from rce.mapping.trials.relations import Error, Relations, error_of, read_relations, relations_of
from rce.mapping.trials.trial import Trial, run

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
