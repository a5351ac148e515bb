"""Follower of the changes of the repository, on a thread of its own. Without ROS."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rce.api.knowledge import Change
from rce.api.knowledge_requests import WaitForChanges
from rce.client.environment_knowledge import EnvironmentKnowledge
from rce.errors import RceError

PAUSE = 0.5  # seconds between checks for listeners, and after a failure


class Follower:
    """Passes changes on while somebody listens, from the first moment on at which somebody does."""

    def __init__(
        self, knowledge: EnvironmentKnowledge, listeners: Callable[[], int], publish: Callable[[Change], None]
    ) -> None:
        """Begin to follow; `listeners` returns their number, `publish` gets each change, both on the thread."""
        self._knowledge, self._listeners, self._publish = knowledge, listeners, publish
        self._after: int | None = None  # number of the last change that was seen
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="changes", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Publish nothing any more. A request that waits for changes ends by itself."""
        self._stopped.set()

    def _run(self) -> None:
        while not self._stopped.is_set():
            if not self._listeners():
                self._after = None
                self._stopped.wait(PAUSE)
                continue
            try:
                answer = self._knowledge.ask(WaitForChanges(self._after))
            except RceError:  # the service is away; what happens meanwhile comes afterwards
                self._stopped.wait(PAUSE)
                continue
            self._after = answer.newest
            for change in answer.changes:
                if not self._stopped.is_set():
                    self._publish(change)
