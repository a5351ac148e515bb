"""The interactive console on a terminal: completion, history, and a prompt that says where and who one is."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from prompt_toolkit import PromptSession
from prompt_toolkit.completion import CompleteEvent, Completer, Completion, ThreadedCompleter
from prompt_toolkit.document import Document
from prompt_toolkit.history import FileHistory

from rce.console.completing import Names, candidates
from rce.console.script import carry_out
from rce.console.session import Session
from rce.errors import RceError

WELCOME = "Tab completes, `help` lists the commands, Ctrl-D leaves."


class History(FileHistory):
    """Lines that may have a password in them are not kept."""

    def store_string(self, string: str) -> None:
        if "password" not in string and "passwd" not in string and " -p" not in string:
            super().store_string(string)


class CommandCompleter(Completer):
    """Completes the word before the cursor."""

    def __init__(self, session: Session) -> None:
        self._names = Names(session)

    def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterator[Completion]:
        words = split_begun(document.text_before_cursor)
        for word, text in candidates(words, self._names, platform=False).items():
            yield Completion(word, start_position=-len(words[-1]), display_meta=text)


def split_begun(line: str) -> list[str]:
    """The words of a line that is being typed; the last is the one at the cursor, empty after a blank."""
    words = line.split()
    return words if words and not line[-1].isspace() else [*words, ""]


def converse(session: Session) -> int:
    """Read and carry out lines until Ctrl-D or `exit`; the status is that of the last command."""
    prompts: PromptSession[str] = PromptSession(
        history=History(str(_history())),
        completer=ThreadedCompleter(CommandCompleter(session)),
        complete_while_typing=False,
    )
    print(WELCOME)
    status = 0
    while True:
        try:
            line = prompts.prompt(_prompt(session))
        except KeyboardInterrupt:
            continue  # a line thought better of
        except EOFError:
            return status
        try:
            status = carry_out(line, session)
        except SystemExit:
            return status


def _prompt(session: Session) -> str:
    try:
        access = session.access
    except RceError:
        return "not signed in> "
    return f"{access.user or 'rce'}@{access.url.partition('://')[2].rstrip('/')}> "


def _history() -> Path:
    base = Path(os.environ.get("XDG_STATE_HOME") or "~/.local/state").expanduser() / "rce"
    base.mkdir(mode=0o700, parents=True, exist_ok=True)
    path = base / "console_history"
    path.touch(mode=0o600)
    return path
