"""The credential with which a process joins the Master: a one-time token first, then what the Master gave for it."""

from __future__ import annotations

import os
from pathlib import Path

from twisted.logger import Logger

from rce.calls.joining import Welcome
from rce.control import MasterLink
from rce.errors import Unauthorized

log = Logger()


class Credential:
    """The stored credential if there is one, else the join token. `file` is readable by its owner only."""

    def __init__(self, file: Path, token: str) -> None:
        self._file = file
        self._token = token
        self._stored = file.read_text() if file.exists() else ""

    @property
    def secret(self) -> str:
        return self._stored or self._token

    def keep(self, welcome: Welcome) -> None:
        """Store what the Master gave; raises OSError."""
        if welcome.credential == self._stored:
            return
        draft = self._file.with_name(self._file.name + ".new")
        draft.unlink(missing_ok=True)
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(welcome.credential)
            file.flush()
            os.fsync(file.fileno())  # the token that it replaces is used up
        draft.rename(self._file)
        self._stored = welcome.credential

    def forget(self) -> bool:
        """Drop the stored credential, which the Master refused; whether there is a token to try instead."""
        refused = self._stored
        self._stored = ""
        self._file.unlink(missing_ok=True)
        return bool(refused and self._token)


async def stay_joined(link: MasterLink, credential: Credential) -> None:
    """Keep the connection to the Master. A stored credential that it refuses gives way to the join token, once.

    Returns only by the error with which the Master refuses this process.
    """
    try:
        await link.run()
    except Unauthorized as error:
        if not credential.forget():
            raise
        log.warn("{error}; the stored credential is dropped and the join token tried", error=str(error))
        await link.run()
