"""Secrets of an environment: files in memory that only its nodes can read, and variables of nodes."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from rce.control.calls.endpoints import Secret

DIRECTORY = "RCE_SECRETS_DIR"  # variable of nodes
MEMORY = Path("/dev/shm")


class Secrets:
    """Files of one life of an environment, which `variables` of its nodes lead to."""

    def __init__(self, run: str, variables: dict[str, str], memory: Path = MEMORY) -> None:
        self.directory = memory / f"rce-secrets-{run}"
        self._variables = variables
        self._names: set[str] = set()
        self._present: dict[str, Secret] = {}

    def put(self, secrets: dict[str, Secret]) -> None:
        """Write the secrets, for nodes that start from now on, in place of those before."""
        if secrets == self._present:  # nodes may be reading them
            return
        self.remove()
        if not secrets:
            return
        self._present = secrets
        self.directory.mkdir(mode=0o700)
        for name, secret in secrets.items():
            descriptor = os.open(self.directory / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o400)
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                file.write(secret.value)
            if secret.variable:
                self._set(secret.variable, secret.value)
        self._set(DIRECTORY, str(self.directory))

    def remove(self) -> None:
        """Remove files and variables."""
        for name in self._names:
            self._variables.pop(name, None)
        self._names.clear()
        self._present = {}
        shutil.rmtree(self.directory, ignore_errors=True)

    def _set(self, name: str, value: str) -> None:
        self._variables[name] = value
        self._names.add(name)
