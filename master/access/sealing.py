"""Sealing of users' secrets: what the database keeps of them cannot be read without the key, a file beside it."""

from __future__ import annotations

import os
from pathlib import Path

from cryptography.fernet import Fernet, InvalidToken

from rce.errors import InvalidRequest, NotFound

KEY_FILE = "secrets.key"


class Seal:
    """Seals and opens texts. Without a file the key lasts as long as this object."""

    def __init__(self, file: Path | None = None) -> None:
        self._file = file
        self._key: Fernet | None = None

    def close(self, text: str) -> str:
        """Return a text sealed."""
        return self._fernet().encrypt(text.encode()).decode()

    def open(self, sealed: str) -> str:
        """Return a sealed text.

        Raises:
            NotFound: It was sealed with another key.
        """
        try:
            return self._fernet().decrypt(sealed.encode()).decode()
        except InvalidToken:
            raise NotFound("it was sealed with another key: restore that file, or set the secret again") from None

    def _fernet(self) -> Fernet:
        if self._key is None:
            self._key = _read(self._file) if self._file is not None else Fernet(Fernet.generate_key())
        return self._key


def _read(file: Path) -> Fernet:
    """Return the key of a file, which is made with mode 0600 if it does not exist."""
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        pass
    else:
        with os.fdopen(descriptor, "wb") as new:
            new.write(Fernet.generate_key())
            new.flush()
            os.fsync(new.fileno())
    try:
        return Fernet(file.read_bytes())
    except ValueError:
        raise InvalidRequest(f"{file} is not the key of secrets: restore it from where it was saved") from None
