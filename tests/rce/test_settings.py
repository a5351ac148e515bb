"""Where settings come from, which source wins, and what is said of a wrong one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pytest
from msgspec import Meta, Struct

from rce import settings
from rce.errors import InvalidRequest


class Options(Struct):
    """A program."""

    data_dir: Annotated[Path, Meta(description="directory")]
    ws_port: Annotated[int, Meta(ge=0, le=65535, description="port; 100% of them")] = 9010
    grace: float = 10
    dev: bool = False
    mode: Literal["fast", "slow"] = "fast"
    tokens: list[str] = []


def load(*arguments: str, **environment: str) -> Options:
    return settings.load(Options, "rce test", ["--data-dir", "/d", *arguments], environment)


def test_defaults() -> None:
    assert load() == Options(Path("/d"))


def test_the_command_line_wins_over_the_environment_and_that_over_the_file(tmp_path: Path) -> None:
    file = tmp_path / "rce.toml"
    file.write_text('ws_port = 1\ngrace = 1\nmode = "slow"\ntokens = ["a", "b,c"]\ndev = true\n')
    options = load("--config", str(file), "--ws-port", "3", RCE_WS_PORT="2", RCE_GRACE="2.5")
    assert options == Options(Path("/d"), 3, 2.5, True, "slow", ["a", "b,c"])


def test_a_flag_can_be_taken_back(tmp_path: Path) -> None:
    assert load("--dev", RCE_DEV="false").dev
    assert not load("--no-dev", RCE_DEV="true").dev


def test_lists_and_paths_as_text(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/me")
    options = settings.load(Options, "rce test", ["--tokens", "a:b,,c"], {"RCE_DATA_DIR": "~/x"})
    assert (options.tokens, options.data_dir) == (["a:b", "c"], Path("/home/me/x"))


@pytest.mark.parametrize(
    ("arguments", "environment", "said"),
    [
        (["--ws-port", "x"], {}, ["command line", "ws_port", "'x'", "int"]),
        ([], {"RCE_WS_PORT": "70000"}, ["environment", "ws_port", "'70000'", "<= 65535"]),
        ([], {"RCE_DEV": "perhaps"}, ["environment", "dev", "bool"]),
        (["--mode", "medium"], {}, ["command line", "mode", "medium"]),
    ],
)
def test_a_wrong_value_is_named_with_its_source(
    arguments: list[str], environment: dict[str, str], said: list[str]
) -> None:
    with pytest.raises(InvalidRequest) as raised:
        load(*arguments, **environment)
    for part in said:
        assert part in str(raised.value)
    assert raised.value.field == said[1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("wsport = 1", "unknown setting 'wsport'"),
        ("ws_port = -1", "ws_port"),
        ("ws_port = [1]", "ws_port"),
        ("ws_port = ", "rce.toml"),
        ("mode = 'fast'\nmode = 'fast'", "rce.toml"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "rce.toml"
    file.write_text(text)
    with pytest.raises(InvalidRequest) as raised:
        load("--config", str(file))
    assert str(file) in str(raised.value)
    assert said in str(raised.value)


def test_a_file_that_is_not_there_or_not_text(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"nothing\.toml"):
        load("--config", str(tmp_path / "nothing.toml"))
    (tmp_path / "binary.toml").write_bytes(b"\xff")
    with pytest.raises(InvalidRequest, match=r"binary\.toml"):
        load("--config", str(tmp_path / "binary.toml"))


def test_a_missing_setting_is_named() -> None:
    with pytest.raises(InvalidRequest, match="data_dir"):
        settings.load(Options, "rce test", [], {})


def test_other_variables_are_none_of_ours() -> None:
    assert load(RCE_UNKNOWN="1", WS_PORT="5") == load()


def test_help_shows_all_and_a_program_ends_with_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        load("--help")
    assert ended.value.code == 0
    text = capsys.readouterr().out
    for part in ("--data-dir", "--ws-port", "100% of them", "default: 9010", "--no-dev", "--config"):
        assert part in text
    with pytest.raises(SystemExit) as refused:
        settings.load_or_exit(Options, "rce test", ["--data-dir", "d", "--ws-port", "x"])
    assert refused.value.code == 2
    assert "ws_port" in capsys.readouterr().err


def test_a_choice_that_there_is_not_is_answered_with_those_that_there_are() -> None:
    with pytest.raises(InvalidRequest, match="mode = 'quick': must be one of fast,slow"):
        load("--mode", "quick")


def test_help_says_what_a_value_is_and_no_default_that_is_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        load("--help")
    text = " ".join(capsys.readouterr().out.split())
    for part in ("--ws-port N", "--data-dir PATH directory (required)", "--mode {fast,slow}", "--tokens LIST"):
        assert part in text
    assert "(default: )" not in text
    assert "default: False" not in text
