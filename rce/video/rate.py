"""Estimate of the bytes per second that a line carries: lower after a drop, higher while there are none."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RateConfig:
    """Settings of the control.

    Attributes:
        lowest: Bytes per second.
        highest: Bytes per second.
        less: Factor after a drop.
        more: Factor after a while without drops.
        pause: Seconds after a change in which further drops belong to the same congestion.
        quiet: Seconds without drops before more is tried. Each change costs a key frame.
    """

    lowest: int = 25_000
    highest: int = 500_000
    less: float = 0.6
    more: float = 1.25
    pause: float = 1.0
    quiet: float = 5.0


RATE_CONFIG = RateConfig()


class RateControl:
    """Rate of one encoder, which begins with the highest."""

    def __init__(self, config: RateConfig = RATE_CONFIG) -> None:
        """Make a control."""
        self._config = config
        self.rate = config.highest
        self._changed = self._dropped = -float("inf")

    def report(self, now: float, dropped: bool) -> bool:
        """Tell whether a packet was dropped; return whether `rate` has changed.

        Args:
            now: Seconds, of any clock that does not go back.
            dropped: Whether the newest packet, or one since the last report, was dropped.
        """
        config, factor = self._config, 1.0
        if dropped:
            self._dropped = now
            factor = config.less if now - self._changed >= config.pause else 1.0
        elif now - max(self._changed, self._dropped) >= config.quiet:
            factor = config.more
        rate = max(config.lowest, min(config.highest, round(self.rate * factor)))
        if rate == self.rate:
            return False
        self.rate, self._changed = rate, now
        return True
