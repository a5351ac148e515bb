"""Credential of a process for joining the Master.

The process makes it, and presents it together with its one-time join token when it joins for the first time.
"""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from twisted.logger import Logger

from rce.control.calls.joining import Welcome
from rce.control.client import ControlClient
from rce.errors import Unauthorized

log = Logger()


class Credential:
    """The stored credential, or a new one with the join token. Only the owner can read the file."""

    def __init__(self, file: Path, token: str) -> None:
        """Read the stored credential, or store a new one if there is a join token to present with it.

        Raises:
            OSError: The file cannot be read or written.
        """
        self._file = file
        self._token = token
        self._stored = file.read_text() if file.exists() else ""
        self._is_new = not self._stored  # the Master does not know it, as far as this process knows
        if self._is_new and token:
            self._store(secrets.token_hex(32))

    @property
    def secret(self) -> str:
        """The secret for the next join."""
        return self._token if self._is_new else self._stored

    @property
    def own(self) -> str:
        """The credential to present with the join token; empty if the Master knows it."""
        return self._stored if self._is_new else ""

    def keep(self, welcome: Welcome) -> None:
        """Note that the process has joined by this credential.

        Raises:
            OSError: The file cannot be written.
        """
        if welcome.credential != self._stored:
            self._store(welcome.credential)
        self._is_new = False

    def forget(self) -> bool:
        """Delete the credential, which the Master refused; return True if there is a join token to try with a new one.

        The old one is not used again, because whoever has a copy of it must not join.
        """
        self._file.unlink(missing_ok=True)
        if self._is_new or not self._token:
            return False
        self._store(secrets.token_hex(32))
        self._is_new = True
        return True

    def _store(self, secret: str) -> None:
        draft = self._file.with_name(self._file.name + ".new")
        draft.unlink(missing_ok=True)
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(secret)
            file.flush()
            os.fsync(file.fileno())  # the join token is good for one credential, so a lost one cannot be replaced
        draft.rename(self._file)
        self._stored = secret


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
