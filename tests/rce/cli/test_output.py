"""Printed tables and records."""

from __future__ import annotations

import pytest

from rce.api.views import RobotView, Usage
from rce.cli import output
from rce.cli.execute import SUCCESS
from rce.protocol.messages import ContainerData, Rates
from tests.support.console import Console, environment, interface, machine, node, open_terminal

GROUPED = ContainerData(cpu=2, memory=3 * 2**29, group="fleet", image="registry.example.org:5000/rce/mapping:0.1.0")

COLUMNS: output.Columns[tuple[str, str]] = {"name": lambda each: each[0], "text": lambda each: each[1]}


def test_titles_are_bold_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = open_terminal(monkeypatch, 20)
    monkeypatch.setenv("TERM", "xterm")
    output.print_table([("a", "12345"), ("long", "1")], COLUMNS)
    assert terminal.getvalue().splitlines() == ["\x1b[1mNAME  TEXT\x1b[0m", "a     12345", "long  1"]


def test_dumb_terminal_gets_no_control_sequences(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = open_terminal(monkeypatch, 20)
    output.print_table([("a", "\x1b[31mred")], COLUMNS)
    assert terminal.getvalue().splitlines() == ["NAME  TEXT", "a     [31mred"]


def test_columns_left_out_are_named_on_standard_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal = open_terminal(monkeypatch, 20)
    columns: output.Columns[str] = {"environment": str, "interfaces": len, "machine": str}
    output.print_table(["brain"], columns)
    assert "MACHINE" not in terminal.getvalue()
    assert capsys.readouterr().err == "left out: INTERFACES, MACHINE (the terminal is too narrow)\n"


def test_output_to_a_pipe_is_plain_text_of_any_width(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_table([("a", "0123456789 " * 20)], COLUMNS)
    assert capsys.readouterr().out.splitlines() == ["NAME  TEXT", "a     " + ("0123456789 " * 20).rstrip()]


def test_empty_list_is_mentioned_on_standard_error(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_table([], COLUMNS)
    assert capsys.readouterr() == ("", "none\n")


def test_list_in_json_is_complete(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_table(iter([("a", "b")]), COLUMNS, as_json=True)
    assert capsys.readouterr().out == '[["a","b"]]\n'


@pytest.mark.parametrize(
    ("list_command", "views"),
    [
        ("env list", [environment("brain_of_scout", user="alexander", containerData=GROUPED)]),
        ("node list brain", [node(args="--ros-args -p rate:=10 -p frame:=base_link", namespace="/robots/r2")]),
        ("interface list", [interface("brain_of_scout", "camera_out", addr="/robots/r2/camera/depth")]),
        ("machine list", [machine("west", url="wss://robots.example.org:9010/", features=["gpu", "arm"])]),
        ("machine stats", [machine(usage=Usage(1.5, 2**31), gpus=2)]),
        ("robot list", [RobotView("alexander", "robot_of_the_hall", "connected", "machine-1-robots", 12)]),
    ],
)
def test_list_has_whole_words_in_80_columns(
    list_command: str, views: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = open_terminal(monkeypatch, 80)
    assert Console(views).run(list_command) == SUCCESS
    narrow = terminal.getvalue()
    assert max(map(len, narrow.splitlines())) <= 80
    terminal = open_terminal(monkeypatch, 1000)
    assert Console(views).run(list_command) == SUCCESS
    breaks = terminal.getvalue().replace("/", "/ ").replace(",", ", ")
    assert {*narrow.replace("/", "/ ").replace(",", ", ").split()} <= {*breaks.split()}


def test_record_is_wrapped_beside_its_names_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = open_terminal(monkeypatch, 30)
    output.print_record({"name": "a", "text": "all of the words of a text"})
    assert terminal.getvalue().splitlines() == ["name  a", "text  all of the words of a", "      text"]


def test_record_is_printed_with_times_and_sizes(capsys: pytest.CaptureFixture[str]) -> None:
    data = ContainerData(memory=2**30, io=Rates(read=2**20))
    created = 86400.0 * 365
    output.print_record(
        {"created": created, "containerData": data, "total_memory": 3 * 2**30, "robots": 0, "empty": ""}
    )
    assert capsys.readouterr().out.splitlines() == [
        f"created        {output.local_time(created)}",
        "containerData  memory=1 GiB, io=read=1 MiB",
        "total_memory   3 GiB",
        "robots         0",
    ]


def test_record_without_values_prints_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_record({"containerData": ContainerData()})
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        ("", "-"),
        (0, "0"),
        (True, "yes"),
        (2.0, "2"),
        (0.125, "0.125"),
        ([], "-"),
        (["a", 1], "a, 1"),
        ({"a": None}, "-"),
        ({"a": 1, "b": ""}, "a=1"),
        (Rates(read=2**20), "read=1 MiB"),
    ],
)
def test_cell_shows_a_value_as_text(value: object, text: str) -> None:
    assert output.cell_text(value) == text


@pytest.mark.parametrize(
    ("size", "text"),
    [(None, "-"), (0, "0 B"), (1023, "1023 B"), (1024, "1 KiB"), (3 * 2**29, "1.5 GiB"), (2**50, "1024 TiB")],
)
def test_size_has_a_binary_prefix(size: int | None, text: str) -> None:
    assert output.size_text(size) == text


def test_missing_time_is_replaced() -> None:
    assert output.local_time(None, "never") == "never"
    assert output.local_time(0) == "-"


def test_used_slots_are_a_number_and_the_last_use_of_a_key_is_a_time(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_record({"slots": 10, "used": 1})
    output.print_record({"used": 1_700_000_000.5})
    slots, key = capsys.readouterr().out.strip().splitlines()[1:]
    assert slots.split() == ["used", "1"]
    assert "2023-11-1" in key
