"""The table of commands, and what is made of it: command lines, help, completion, the original's spellings."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence

import pytest

from rce.console import show, table
from rce.console.command import Live, Usage, parser
from rce.console.completing import Names, candidates
from rce.console.original import modern
from rce.console.run import WRONG, run
from rce.console.session import Session
from rce.messages import ContainerData, Rates

ALL = list(table.COMMANDS.values())


class Known(Names):
    """Names without a platform."""

    def __init__(self) -> None:
        super().__init__(Session())

    def of(self, live: Live, words: Sequence[str] = ()) -> list[str]:
        return {"environment": ["brain", "brawn"], "interface": ["brain/pose"], "user": ["ada"]}.get(live, [])


@pytest.mark.parametrize("command", ALL, ids=lambda each: each.name)
def test_examples_are_good_command_lines(command: table.Command) -> None:
    for example in command.examples:
        found, arguments = table.find(shlex.split(re.split("[<>]", example)[0]))
        assert found is command
        parser(command).parse_args(arguments)


@pytest.mark.parametrize("command", ALL, ids=lambda each: each.name)
def test_every_command_has_help(command: table.Command) -> None:
    text = parser(command).format_help()
    assert command.help in text
    assert command.help.endswith(".")


ORIGINAL = {
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
    "parameter add -c c1 -n rate -v 5": "param set c1 rate 5",
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


@pytest.mark.parametrize("line", ORIGINAL)
def test_a_spelling_of_the_original(line: str) -> None:
    words = modern(shlex.split(line))
    assert words == shlex.split(ORIGINAL[line])
    command, arguments = table.find(words)
    assert command is not None
    parser(command).parse_args(arguments)


@pytest.mark.parametrize("command", ALL, ids=lambda each: each.name)
def test_ours_are_not_taken_for_the_original_s(command: table.Command) -> None:
    for example in command.examples:
        assert modern(shlex.split(example)) == shlex.split(example)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("en", {"env"}),
        ("env sh", {"show", "shell"}),
        ("env show bra", {"brain", "brawn"}),
        ("env show --j", {"--json"}),
        ("env create --restart ", {"always", "no"}),
        ("connect brain/pose b", {"brain/pose"}),
        ("env list --of ", {"ada"}),
        ("watch env de", {"delete"}),
        ("env delete brain b", {"brain", "brawn"}),
        ("env show brain b", set()),
        ("nothing ", set()),
        ("completion ", {"bash", "zsh", "fish"}),
    ],
)
def test_completion(line: str, expected: set[str]) -> None:
    words = line.split() + ([""] if line.endswith(" ") else [])
    assert set(candidates(words, Known())) == expected


def test_options_that_name_the_platform_are_no_part_of_a_console_s_lines() -> None:
    assert "--url" in candidates(["env", "list", "--u"], Known())
    assert "--url" not in candidates(["env", "list", "--u"], Known(), platform=False)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("env", "env create"),
        ("env made", "there is no command `env made`"),
        ("env show", "required: ENV"),
        ("env show a --jsn", "unrecognized arguments: --jsn"),
        ("nonsense", "no command 'nonsense'; `rce help`"),
    ],
)
def test_wrong_words_are_answered_with_the_right_ones(line: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(line.split()) == WRONG
    told = capsys.readouterr()
    assert text in told.out + told.err


def test_usage_says_how_the_line_should_be() -> None:
    with pytest.raises(Usage, match="usage: rce env show"):
        parser(table.COMMANDS["env show"]).parse_args([])


def test_one_thing_is_shown_with_times_and_amounts(capsys: pytest.CaptureFixture[str]) -> None:
    data = ContainerData(memory=2**30, io=Rates(read=2**20))
    show.one({"created": 86400.0 * 365, "containerData": data, "total_memory": 3 * 2**30, "robots": 0, "empty": ""})
    assert capsys.readouterr().out.splitlines() == [
        f"created        {show.when(86400.0 * 365)}",
        "containerData  memory=1 GiB, io=read=1 MiB",
        "total_memory   3 GiB",
        "robots         0",
    ]
    show.one({"containerData": ContainerData()})
    assert capsys.readouterr().out == "", "what has nothing in it has no value"
