"""A user's shell on a terminal: commands are typed, and must succeed."""

from __future__ import annotations

import asyncio
import os
import re
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.support.e2e.consoles import TerminalProcess, user_environ
from tests.support.e2e.real_platform import kill_processes
from tests.support.e2e.transcripts import play, steps

PROMPT = "<$?>"
CACHES = {"PIP_CACHE_DIR": "pip", "UV_CACHE_DIR": "uv"}  # kept, so that not all is downloaded again


class Shell:
    """Bash with a home directory of its own; at the end all processes that began in it are killed."""

    def __init__(self, home: Path, directory: Path) -> None:
        """Prepare a shell that begins in `directory`."""
        self.home = home
        self._directory = directory
        self._terminal: TerminalProcess

    async def __aenter__(self) -> Self:
        caches = {name: os.environ.get(name, f"{Path.home()}/.cache/{each}") for name, each in CACHES.items()}
        env = caches | user_environ(self.home) | {"PS1": PROMPT, "PS2": "", "COLUMNS": "500"}
        self._terminal = TerminalProcess(["bash", "--norc", "--noediting", "-i"], env, columns=500)
        try:
            await self.expect("<0>")
            await self.run(f"stty -echo; set +m; PS1='{PROMPT}'; cd {self._directory}")
        except BaseException:
            self._terminal.close()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._terminal.close()
        kill_processes(self.home)

    def type(self, text: str) -> None:
        self._terminal.type(text)

    async def expect(self, pattern: str, seconds: float = 120.0) -> str:
        """Return the output up to a match."""
        return await asyncio.to_thread(self._terminal.expect, pattern, seconds)

    async def run(self, command: str, *answers: tuple[str, str], seconds: float = 120.0) -> str:
        """Return the output of a command that ends with status 0, after the answers to its prompts."""
        self.type(f"{command}\n")
        for prompt, answer in answers:
            await self.expect(re.escape(prompt))
            self.type(f"{answer}\n")
        seen = await self.expect(r"<\d+>$", seconds)
        text, status = re.split(r"<(\d+)>$", seen)[:2]
        assert status == "0", f"$ {command}\n{seen}"
        return text.replace("\r", "")

    async def follow(self, document: Path, replaced: Mapping[str, str]) -> int:
        """Type the commands of a document, and compare their output with what it shows; return their number."""
        commands = list(steps(document, replaced))
        for step in commands:
            await asyncio.to_thread(play, self._terminal, step)
        return len(commands)
