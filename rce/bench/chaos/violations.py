"""Error of a run in which the platform did not keep a promise, with the evidence."""

from __future__ import annotations

from pathlib import Path

from rce.bench.chaos.history import History
from rce.errors import RceError

TAIL = 40  # entries of the history that a failure shows
LOG_TAIL = 60  # lines of the logs, without those of level info, that a failure shows


class Violation(RceError):
    """The platform did not keep a promise; the message has the seed and the ends of history and logs."""

    code = "violation"


def violation(errors: BaseExceptionGroup[Exception], seed: int, directory: Path, history: History) -> Violation:
    """Return the error of a run that ended with `errors`, whose history and `log` are in `directory`."""
    reasons = "\n".join(f"{type(each).__name__}: {each}" for each in _leaves(errors))
    return Violation(
        f"{reasons}\nseed {seed}, last entries of {directory / 'history.jsonl'}:\n{history.tail(TAIL)}\n"
        f"end of {directory / 'log'}:\n{_end_of(directory / 'log')}"
    )


def _leaves(group: BaseExceptionGroup[Exception]) -> list[BaseException]:
    return [
        leaf
        for each in group.exceptions
        for leaf in (_leaves(each) if isinstance(each, BaseExceptionGroup) else [each])
    ]


def _end_of(file: Path) -> str:
    lines = file.read_text(errors="replace").splitlines() if file.exists() else []
    return "\n".join([line for line in lines if '"level":"info"' not in line][-LOG_TAIL:])
