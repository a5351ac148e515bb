"""Translation of the command lines of the original Rapyuta console.

The original took options (`interface add -e brain -i pose -t PublisherInterface …`) where this console takes positional
arguments. A line in another form is left unchanged.
"""

from __future__ import annotations

import getopt
import json
from collections.abc import Callable, Sequence
from typing import NamedTuple

Options = dict[str, str]


class Spelling(NamedTuple):
    """Command of the original, with its translation.

    `options` lists its options as `long/s`, with `=` at the end if the option takes a value. A line is the original's
    if it has all options in `required`, and no others than those in `options`.
    """

    words: str
    options: str
    required: str
    translate: Callable[[Options], list[str]]


def _options(options: Options, **flags: str) -> list[str]:
    """Return the options that are given, each under its new name."""
    return [f"--{flag.replace('_', '-')}={options[name]}" for flag, name in flags.items() if name in options]


SPELLINGS = (
    Spelling(
        "user add",
        "username/u= password/p=",
        "username",
        lambda o: ["user", "add", o["username"], *_options(o, password="password")],
    ),
    Spelling("user remove", "username/u=", "username", lambda o: ["user", "remove", o["username"]]),
    Spelling(
        "user update",
        "username/u= password/p=",
        "username",
        lambda o: ["user", "passwd", o["username"], *_options(o, new="password")],
    ),
    Spelling("user passwd", "new/p= old/o=", "new", lambda o: ["user", "passwd", *_options(o, new="new", old="old")]),
    Spelling("user", "list/l", "list", lambda _: ["user", "list"]),
    Spelling(
        "container start",
        "name/n= group/g= groupIp/a= size/s= cpu/c= memory/m= bandwidth/b= specialopts/o=",
        "name",
        lambda o: [
            *("env", "create", o["name"]),
            *_options(o, group="group", group_ip="groupIp", size="size", cpu="cpu", memory="memory"),
            *_options(o, bandwidth="bandwidth", feature="specialopts"),
        ],
    ),
    Spelling("container", "stop/t=", "stop", lambda o: ["env", "delete", o["stop"]]),
    Spelling("container", "services/v=", "services", lambda o: ["service", "list", o["services"]]),
    Spelling("container", "topics/o=", "topics", lambda o: ["topic", "list", o["topics"]]),
    Spelling("container", "list/l", "list", lambda _: ["env", "list"]),
    Spelling("container", "username/u=", "username", lambda o: ["env", "list", "--of", o["username"]]),
    Spelling(
        "node start",
        "ctag/c= ntag/n= pkg/p= exe/e= args/a=",
        "ctag ntag pkg exe",
        lambda o: ["node", "start", o["ctag"], o["ntag"], o["pkg"], o["exe"], *_options(o, args="args")],
    ),
    Spelling("node stop", "ctag/c= ntag/n=", "ctag ntag", lambda o: ["node", "stop", o["ctag"], o["ntag"]]),
    Spelling(
        "parameter add",
        "ctag/c= name/n= value/v=",
        "ctag name value",
        lambda o: ["param", "set", o["ctag"], o["name"], json.dumps(o["value"])],  # always a string
    ),
    Spelling("parameter remove", "ctag/c= name/n=", "ctag name", lambda o: ["param", "delete", o["ctag"], o["name"]]),
    Spelling(
        "interface add",
        "etag/e= itag/i= itype/t= icls/c= addr/a=",
        "etag itag itype icls",
        lambda o: ["interface", "add", f"{o['etag']}/{o['itag']}", o["itype"], o["icls"], o.get("addr", "")],
    ),
    Spelling(
        "interface remove",
        "etag/e= itag/i=",
        "etag itag",
        lambda o: ["interface", "remove", f"{o['etag']}/{o['itag']}"],
    ),
    Spelling("connection add", "tag1/1= tag2/2=", "tag1 tag2", lambda o: ["connect", o["tag1"], o["tag2"]]),
    Spelling("connection remove", "tag1/1= tag2/2=", "tag1 tag2", lambda o: ["disconnect", o["tag1"], o["tag2"]]),
    Spelling("robot", "list/l", "list", lambda _: ["robot", "list"]),
    Spelling("robot", "username/u=", "username", lambda o: ["robot", "list", "--of", o["username"]]),
    Spelling("machine", "list/l", "list", lambda _: ["machine", "list"]),
    Spelling("machine", "stats/s=", "stats", lambda o: ["machine", "stats", o["stats"]]),
    Spelling("machine", "containers/c=", "containers", lambda o: ["machine", "environments", o["containers"]]),
)


def translate(words: Sequence[str]) -> list[str]:
    """Return a line of the original's console in the words of this one, and any other line unchanged."""
    for spelling in SPELLINGS:
        head = spelling.words.split()
        if list(words[: len(head)]) == head:
            options = _parse(spelling.options, words[len(head) :])
            if options is not None and all(name in options for name in spelling.required.split()):
                return spelling.translate(options)
    return list(words)


def help_of(word: str) -> str:
    """Return the forms of the original's commands that begin with a word; empty if there are none."""
    lines = [f"  {spelling.words} {_usage(spelling)}" for spelling in SPELLINGS if spelling.words.split()[0] == word]
    return "\n".join([f"`{word}` as in the original's console:", *lines]) if lines else ""


def _usage(spelling: Spelling) -> str:
    needed = spelling.required.split()
    words = []
    for option in spelling.options.split():
        name, _, short = option.partition("/")
        text = f"-{short[0]}, --{name}{' ' + name.upper() if short.endswith('=') else ''}"
        words.append(text if name in needed else f"[{text}]")
    return " ".join(words)


def _parse(specification: str, words: Sequence[str]) -> Options | None:
    """Return the options by their long names, or None if there is anything else."""
    names = [option.partition("/") for option in specification.split()]
    long = [name + ("=" if short.endswith("=") else "") for name, _, short in names]
    short = "".join(short.replace("=", ":") for _, _, short in names)
    long_name = {f"-{short[0]}": name for name, _, short in names} | {f"--{name}": name for name, _, _ in names}
    try:
        found, rest = getopt.getopt(list(words), short, long)
    except getopt.GetoptError:
        return None
    return None if rest else {long_name[option]: value for option, value in found}
