"""The interactive console: history, completion, prompt and exit status."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

pytest.importorskip("prompt_toolkit", reason="needs the extra `console`")

from prompt_toolkit.application import create_app_session
from prompt_toolkit.completion import CompleteEvent
from prompt_toolkit.document import Document
from prompt_toolkit.input import create_pipe_input
from prompt_toolkit.output import DummyOutput

from rce.cli.contexts import Access
from rce.cli.execute import SUCCESS, USAGE_ERROR
from rce.cli.interactive import WELCOME, CommandCompleter, History, _prompt, run_console, split_incomplete
from rce.cli.session import ConsoleSession
from tests.support.console import Console, environment


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Directory of the history."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "rce"


def typed(console: Console, keys: str) -> int:
    """Run the console with these keys and return its exit status."""
    with create_pipe_input() as stdin, create_app_session(stdin, DummyOutput()):
        stdin.send_text(keys)
        return run_console(console.session)


@pytest.mark.parametrize(
    ("line", "words"),
    [("", [""]), ("env", ["env"]), ("env ", ["env", ""]), ("env sh", ["env", "sh"]), ("  env  sh", ["env", "sh"])],
)
def test_last_word_is_the_one_at_the_cursor(line: str, words: list[str]) -> None:
    assert split_incomplete(line) == words


@pytest.mark.parametrize(
    ("line", "kept"),
    [
        ("env list", True),
        ("user add ada --password x", False),
        ("user passwd --new x", False),
        ("user add -u ada -px", False),
        ("topic pub brain/say std_msgs/String", True),
    ],
)
def test_lines_with_passwords_are_not_stored(line: str, kept: bool, tmp_path: Path) -> None:
    file = tmp_path / "history"
    History(str(file)).store_string(line)
    assert (file.exists() and line in file.read_text()) is kept


def test_word_before_the_cursor_is_completed() -> None:
    completer = CommandCompleter(Console([environment("brain"), environment("brawn")]).session)
    document = Document("env show bra and more", cursor_position=len("env show bra"))
    found = list(completer.get_completions(document, CompleteEvent()))
    assert [(each.text, each.start_position) for each in found] == [("brain", -3), ("brawn", -3)]


def test_completed_command_has_its_help() -> None:
    (found,) = CommandCompleter(Console().session).get_completions(Document("env sho"), CompleteEvent())
    assert (found.text, found.display_meta_text) == ("show", "Show an environment.")


@pytest.mark.parametrize(
    ("access", "prompt"),
    [
        (Access("http://127.0.0.1:9000/", "ann", None, "rce_k"), "ann@127.0.0.1:9000> "),
        (Access("https://robots.example.org/", "", None, "rce_k"), "rce@robots.example.org> "),
    ],
)
def test_prompt_names_user_and_platform(access: Access, prompt: str) -> None:
    session = Console().session
    session.__dict__["access"] = access
    assert _prompt(session) == prompt


def test_prompt_without_a_context_says_so(no_context: Path) -> None:
    assert _prompt(ConsoleSession()) == "not signed in> "


@pytest.mark.parametrize(("end", "status"), [("\x04", USAGE_ERROR), ("exit\n", USAGE_ERROR)])
def test_console_ends_with_the_status_of_the_last_command(
    end: str, status: int, state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    console = Console()
    assert typed(console, f"env delete a\nnothing\n{end}") == status
    assert [each.line for each in console.api.requests] == ["DELETE environments/a"]
    assert capsys.readouterr().out.startswith(WELCOME)


def test_ctrl_c_discards_the_line(state: Path) -> None:
    console = Console()
    assert typed(console, "env delete a\x03env delete b\n\x04") == SUCCESS
    assert [each.line for each in console.api.requests] == ["DELETE environments/b"]


def test_history_is_readable_by_its_owner_only(state: Path) -> None:
    typed(Console(), "env delete a\n\x04")
    assert "env delete a" in (state / "console_history").read_text()
    assert stat.S_IMODE(state.stat().st_mode) == 0o700
    assert stat.S_IMODE((state / "console_history").stat().st_mode) == 0o600
