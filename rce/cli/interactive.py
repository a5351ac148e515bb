"""The interactive console on a terminal: completion, history, and a prompt with user and platform."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from prompt_toolkit import PromptSession
from prompt_toolkit.completion import CompleteEvent, Completer, Completion, ThreadedCompleter
from prompt_toolkit.document import Document
from prompt_toolkit.history import FileHistory

from rce.cli.completion import Names, candidates
from rce.cli.script import run_line
from rce.cli.session import ConsoleSession
from rce.errors import RceError

WELCOME = "Tab completes, `help` lists the commands, Ctrl-D exits."


class History(FileHistory):
    """History file without the lines that may have a password in them."""

    def store_string(self, string: str) -> None:
        """Append a line to the file, unless it may have a password in it."""
        if "password" not in string and "passwd" not in string and " -p" not in string:
            super().store_string(string)


class CommandCompleter(Completer):
    """Completer of the word before the cursor."""

    def __init__(self, session: ConsoleSession) -> None:
        self._names = Names(session)

    def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterator[Completion]:
        """Yield the candidates for the word before the cursor."""
        words = split_incomplete(document.text_before_cursor)
        for word, text in candidates(words, self._names, in_console=True).items():
            yield Completion(word, start_position=-len(words[-1]), display_meta=text)


def split_incomplete(line: str) -> list[str]:
    """Return the words of an incomplete line; the last is the one at the cursor, empty after a blank."""
    words = line.split()
    return words if words and not line[-1].isspace() else [*words, ""]


def run_console(session: ConsoleSession) -> int:
    """Read and run lines until Ctrl-D or `exit`, and return the status of the last command."""
    prompts: PromptSession[str] = PromptSession(
        history=History(str(_history_file())),
        completer=ThreadedCompleter(CommandCompleter(session)),
        complete_while_typing=False,
    )
    print(WELCOME)
    status = 0
    while True:
        try:
            line = prompts.prompt(_prompt(session))
        except KeyboardInterrupt:
            continue  # discards the line
        except EOFError:
            return status
        try:
            status = run_line(line, session)
        except SystemExit:
            return status


def _prompt(session: ConsoleSession) -> str:
    try:
        access = session.access
    except RceError:
        return "not signed in> "
    return f"{access.user or 'rce'}@{access.url.partition('://')[2].rstrip('/')}> "


def _history_file() -> Path:
    base = Path(os.environ.get("XDG_STATE_HOME") or "~/.local/state").expanduser() / "rce"
    base.mkdir(mode=0o700, parents=True, exist_ok=True)
    path = base / "console_history"
    path.touch(mode=0o600)
    return path
