"""What every container of a task set has in common, whether Docker or Swarm runs it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twisted.internet.base import ReactorBase

from rce.tls import Tls


@dataclass(frozen=True, kw_only=True)
class Setup:
    """`settings` are those of every Environment endpoint (`RCE_…`); `read_only` are directories of each host that every
    environment sees at the same path.
    """

    reactor: ReactorBase
    platform: str
    directory: Path  # of this task set alone
    master: str
    image: str
    settings: Mapping[str, str]
    tls: Tls | None = None
    read_only: Sequence[str] = ()
    command: Sequence[str] = ("python3", "-P", "-m", "endpoints.environment")

    @property
    def labels(self) -> dict[str, str]:
        """By which what the task set has made is known for its own."""
        return {"rce.platform": self.platform, "rce.directory": str(self.directory)}
