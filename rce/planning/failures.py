"""Why there is no path."""

from __future__ import annotations

from enum import StrEnum

from rce.errors import RceError


class Reason(StrEnum):
    """Reason in the field `reason` of `NoPath`. The names are those of Nav2's action ComputePathToPose."""

    START_OUTSIDE_MAP = "start_outside_map"
    GOAL_OUTSIDE_MAP = "goal_outside_map"
    START_OCCUPIED = "start_occupied"
    GOAL_OCCUPIED = "goal_occupied"
    TIMEOUT = "timeout"
    NO_VALID_PATH = "no_valid_path"


class NoPath(RceError):
    """There is no path for this map, robot, start and goal; the field `reason` tells programs why."""

    code = "no_path"

    def __init__(self, message: str, reason: Reason = Reason.NO_VALID_PATH) -> None:
        super().__init__(message, reason=reason.value)

    @property
    def reason(self) -> Reason:
        """Why there is no path."""
        return Reason(str(self.info.fields["reason"]))


def timed_out(seconds: float) -> NoPath:
    """Return the error of a planner that was stopped."""
    return NoPath(f"no path was found within {seconds:g} s: allow more time (max_planning_time)", Reason.TIMEOUT)
