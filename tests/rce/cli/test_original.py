"""Translation of the original console's command lines."""

from __future__ import annotations

import shlex

import pytest

from rce.cli import table
from rce.cli.command import Command, parser
from rce.cli.original import help_of, translate

TRANSLATIONS = {
    "user add -u ann -p Secret1!": "user add ann --password=Secret1!",
    "user add --username=ann --password x": "user add ann --password=x",
    "user remove -u ann": "user remove ann",
    "user update -u ann -p new": "user passwd ann --new=new",
    "user passwd --new b --old a": "user passwd --new=b --old=a",
    "user -l": "user list",
    "container start -n c1 -g fleet -a 192.168.1.5 -s 2 -m 100 -b 5 -o gpu": (
        "env create c1 --group=fleet --group-ip=192.168.1.5 --size=2 --memory=100 --bandwidth=5 --feature=gpu"
    ),
    "container --stop c1": "env delete c1",
    "container -t c1": "env delete c1",
    "container --services c1": "service list c1",
    "container -o c1": "topic list c1",
    "container --list": "env list",
    "container -u ann": "env list --of ann",
    "node start -c c1 -n n1 -p demo -e talker -a '--rate 5'": "node start c1 n1 demo talker '--args=--rate 5'",
    "node stop -c c1 -n n1": "node stop c1 n1",
    "parameter add -c c1 -n rate -v 5": "param set c1 rate '\"5\"'",
    "parameter remove --ctag c1 --name rate": "param delete c1 rate",
    "interface add -e c1 -i i1 -t PublisherInterface -c std_msgs/String -a /say": (
        "interface add c1/i1 PublisherInterface std_msgs/String /say"
    ),
    "interface remove -e c1 -i i1": "interface remove c1/i1",
    "connection add -1 r/a -2 c1/i1": "connect r/a c1/i1",
    "connection remove --tag1 r/a --tag2 c1/i1": "disconnect r/a c1/i1",
    "robot -l": "robot list",
    "robot --username ann": "robot list --of ann",
    "machine --list": "machine list",
    "machine --stats 10.0.0.1": "machine stats 10.0.0.1",
    "machine -c 10.0.0.1": "machine environments 10.0.0.1",
}


@pytest.mark.parametrize("line", TRANSLATIONS)
def test_line_of_the_original_becomes_a_valid_line(line: str) -> None:
    words = translate(shlex.split(line))
    assert words == shlex.split(TRANSLATIONS[line])
    command, arguments = table.find_command(words)
    assert command is not None
    parser(command).parse_args(arguments)


@pytest.mark.parametrize("command", table.COMMANDS.values(), ids=lambda command: command.name)
def test_examples_of_this_console_are_not_translated(command: Command) -> None:
    for example in command.examples:
        assert translate(shlex.split(example)) == shlex.split(example)


def test_help_lists_the_forms_of_the_original() -> None:
    text = help_of("container")
    assert "container start -n, --name NAME [-g, --group GROUP]" in text
    assert "container -l, --list" in text
    assert help_of("nothing") == ""
