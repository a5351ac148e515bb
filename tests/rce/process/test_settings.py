"""Sources of settings, their precedence, and errors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pytest
from msgspec import Meta, Struct

from rce.errors import InvalidRequest
from rce.process import settings


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


def test_command_line_precedes_environment_precedes_file(tmp_path: Path) -> None:
    file = tmp_path / "rce.toml"
    file.write_text('ws_port = 1\ngrace = 1\nmode = "slow"\ntokens = ["a", "b,c"]\ndev = true\n')
    options = load("--config", str(file), "--ws-port", "3", RCE_WS_PORT="2", RCE_GRACE="2.5")
    assert options == Options(Path("/d"), 3, 2.5, True, "slow", ["a", "b,c"])


def test_flag_can_be_negated(tmp_path: Path) -> None:
    assert load("--dev", RCE_DEV="false").dev
    assert not load("--no-dev", RCE_DEV="true").dev


def test_lists_and_paths_are_parsed_from_text(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/me")
    options = settings.load(Options, "rce test", ["--tokens", "a:b,,c"], {"RCE_DATA_DIR": "~/x"})
    assert (options.tokens, options.data_dir) == (["a:b", "c"], Path("/home/me/x"))


@pytest.mark.parametrize(
    ("arguments", "environment", "expected"),
    [
        (["--ws-port", "x"], {}, ["command line", "ws_port", "'x'", "int"]),
        ([], {"RCE_WS_PORT": "70000"}, ["environment", "ws_port", "'70000'", "<= 65535"]),
        ([], {"RCE_DEV": "perhaps"}, ["environment", "dev", "must be true or false"]),
        ([], {"RCE_DEV": ""}, ["environment", "dev", "''", "must be true or false"]),
        (["--mode", "medium"], {}, ["command line", "mode", "medium"]),
    ],
)
def test_error_names_the_setting_and_its_source(
    arguments: list[str], environment: dict[str, str], expected: list[str]
) -> None:
    with pytest.raises(InvalidRequest) as raised:
        load(*arguments, **environment)
    for part in expected:
        assert part in str(raised.value)
    assert raised.value.field == expected[1]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("wsport = 1", "unknown setting 'wsport'"),
        ("ws_port = -1", "ws_port"),
        ("ws_port = [1]", "ws_port"),
        ("ws_port = ", "rce.toml"),
        ("mode = 'fast'\nmode = 'fast'", "rce.toml"),
    ],
)
def test_error_names_a_wrong_file(tmp_path: Path, text: str, expected: str) -> None:
    file = tmp_path / "rce.toml"
    file.write_text(text)
    with pytest.raises(InvalidRequest) as raised:
        load("--config", str(file))
    assert str(file) in str(raised.value)
    assert expected in str(raised.value)


def test_missing_or_binary_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"nothing\.toml"):
        load("--config", str(tmp_path / "nothing.toml"))
    (tmp_path / "binary.toml").write_bytes(b"\xff")
    with pytest.raises(InvalidRequest, match=r"binary\.toml"):
        load("--config", str(tmp_path / "binary.toml"))


def test_error_names_a_missing_setting() -> None:
    with pytest.raises(InvalidRequest, match="data_dir"):
        settings.load(Options, "rce test", [], {})


def test_unknown_environment_variables_are_ignored() -> None:
    assert load(RCE_UNKNOWN="1", WS_PORT="5") == load()


def test_help_lists_all_settings_and_errors_exit_with_status_2(capsys: pytest.CaptureFixture[str]) -> None:
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


def test_error_lists_the_valid_choices() -> None:
    with pytest.raises(InvalidRequest, match="mode = 'quick': must be one of fast,slow"):
        load("--mode", "quick")


def test_help_shows_placeholders_and_omits_empty_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        load("--help")
    text = " ".join(capsys.readouterr().out.split())
    for part in ("--ws-port N", "--data-dir PATH directory (required)", "--mode {fast,slow}", "--tokens LIST"):
        assert part in text
    assert "(default: )" not in text
    assert "default: False" not in text
