"""Credential of a process for joining the Master: first a one-time join token, then the one that the Master issues."""

from __future__ import annotations

import os
from pathlib import Path

from twisted.logger import Logger

from rce.control.calls.joining import Welcome
from rce.control.client import ControlClient
from rce.errors import Unauthorized

log = Logger()


class Credential:
    """The stored credential if there is one, else the join token. The file is readable by its owner only."""

    def __init__(self, file: Path, token: str) -> None:
        self._file = file
        self._token = token
        self._stored = file.read_text() if file.exists() else ""

    @property
    def secret(self) -> str:
        """The secret for the next join."""
        return self._stored or self._token

    def keep(self, welcome: Welcome) -> None:
        """Store the credential that the Master issued.

        Raises:
            OSError: The file cannot be written.
        """
        if welcome.credential == self._stored:
            return
        draft = self._file.with_name(self._file.name + ".new")
        draft.unlink(missing_ok=True)
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(welcome.credential)
            file.flush()
            os.fsync(file.fileno())  # the join token has been consumed, so a lost credential cannot be replaced
        draft.rename(self._file)
        self._stored = welcome.credential

    def forget(self) -> bool:
        """Delete the stored credential, which the Master refused; return True if there is a join token to try."""
        refused = self._stored
        self._stored = ""
        self._file.unlink(missing_ok=True)
        return bool(refused and self._token)


async def stay_joined(link: ControlClient, credential: Credential) -> None:
    """Run a connection to the Master. If it refuses the stored credential, try the join token once.

    Raises:
        RceError: The Master refuses this process.
    """
    try:
        await link.run()
    except Unauthorized as error:
        if not credential.forget():
            raise
        log.warn("{error}: trying the join token instead of the stored credential", error=str(error))
        await link.run()
