"""Settings that all containers of a task set share, whatever engine runs them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twisted.internet.base import ReactorBase

from rce.net.tls import Tls


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Settings that all containers of a task set share.

    `settings` are those of every Environment endpoint (`RCE_…`). `read_only` are directories of each host that every
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
        """Labels of everything that the task set creates, by which it finds it again."""
        return {"rce.platform": self.platform, "rce.directory": str(self.directory)}
