"""Programs of the platform, started by the command `rce`."""

from __future__ import annotations

import pytest

from rce.cli.command import Program
from rce.cli.commands import programs
from rce.process import programs as installed
from rce.process import up


class Started(Exception):
    """A program would have replaced this process."""


@pytest.mark.parametrize(
    "entry",
    [programs.BRIDGE, programs.IMAGE, *programs.SERVERS, *programs.ON_MASTER_FILES],
    ids=lambda entry: entry.name,
)
def test_program_gets_its_arguments_unchanged(entry: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    def exec_program(name: str, arguments: list[str]) -> None:
        raise Started(name, arguments)

    monkeypatch.setattr(installed, "exec_program", exec_program)
    with pytest.raises(Started) as started:
        entry.run(["--config", "a b"])
    assert started.value.args == (entry.name, ["--config", "a b"])


def test_platform_is_started_with_the_settings_of_the_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    served: list[up.Settings] = []

    async def serve(settings: up.Settings) -> None:
        served.append(settings)

    monkeypatch.setattr(up, "serve", serve)
    assert programs.up(["--dev", "--http-port", "9100"]) == 0
    assert [(each.dev, each.http_port) for each in served] == [(True, 9100)]


def test_wrong_setting_of_the_platform_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        programs.up(["--http-port", "many"])
    assert ended.value.code == 2
    assert "rce up" in capsys.readouterr().err
