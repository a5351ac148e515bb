"""Reports of changes to the Master, whose feed tells users of them."""

from __future__ import annotations

from collections.abc import Callable

from twisted.logger import Logger

from rce.control.calls.knowledge import ReportChanges
from rce.errors import RceError
from rce.knowledge.changes import Subscription
from rce.knowledge.records import Reader
from rce.knowledge.repository import Repository
from rce.services.authentication import Master

log = Logger()


async def report_changes(repository: Repository, master: Callable[[], Master]) -> None:
    """Report each change from now on, until cancelled. Those that the Master cannot be told are missing in its feed."""
    _, after = await repository.changes(Reader(""), Subscription(), None)
    while True:
        changed = repository.next_change()
        found, after = await repository.noted(after)
        if not found:
            await changed.wait()
            continue
        try:
            await master().call(ReportChanges(found))
        except RceError as error:
            log.warn("{count} changes are missing in the feed: {error}", count=len(found), error=str(error))
