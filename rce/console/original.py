"""The spellings of the original's console, as those of this one.

What it wrote with options (`interface add -e brain -i pose -t PublisherInterface …`) stands in the order of the words
here. A line that is not of the original stays as it is.
"""

from __future__ import annotations

import getopt
from collections.abc import Callable, Sequence
from typing import NamedTuple

Options = dict[str, str]


class Spelling(NamedTuple):
    """`options`: one of the original's a word, `long/s`, with `=` behind it if it takes a value; those of `needed` tell
    its line from one of ours.
    """

    words: str
    options: str
    needed: str
    modern: Callable[[Options], list[str]]


def _given(options: Options, **flags: str) -> list[str]:
    return [f"--{flag.replace('_', '-')}={options[name]}" for flag, name in flags.items() if name in options]


SPELLINGS = (
    Spelling(
        "user add",
        "username/u= password/p=",
        "username",
        lambda o: ["user", "add", o["username"], *_given(o, password="password")],
    ),
    Spelling("user remove", "username/u=", "username", lambda o: ["user", "remove", o["username"]]),
    Spelling(
        "user update",
        "username/u= password/p=",
        "username",
        lambda o: ["user", "passwd", o["username"], *_given(o, new="password")],
    ),
    Spelling("user passwd", "new/p= old/o=", "new", lambda o: ["user", "passwd", *_given(o, new="new", old="old")]),
    Spelling("user", "list/l", "list", lambda _: ["user", "list"]),
    Spelling(
        "container start",
        "name/n= group/g= groupIp/a= size/s= cpu/c= memory/m= bandwidth/b= specialopts/o=",
        "name",
        lambda o: [
            *("env", "create", o["name"]),
            *_given(o, group="group", group_ip="groupIp", size="size", cpu="cpu", memory="memory"),
            *_given(o, bandwidth="bandwidth", feature="specialopts"),
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
        lambda o: ["node", "start", o["ctag"], o["ntag"], o["pkg"], o["exe"], *_given(o, args="args")],
    ),
    Spelling("node stop", "ctag/c= ntag/n=", "ctag ntag", lambda o: ["node", "stop", o["ctag"], o["ntag"]]),
    Spelling(
        "parameter add",
        "ctag/c= name/n= value/v=",
        "ctag name value",
        lambda o: ["param", "set", o["ctag"], o["name"], o["value"]],
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


def modern(words: Sequence[str]) -> list[str]:
    """A line of the original's console in the words of this one; any other as it is."""
    for spelling in SPELLINGS:
        head = spelling.words.split()
        if list(words[: len(head)]) == head:
            options = _read(spelling.options, words[len(head) :])
            if options is not None and all(name in options for name in spelling.needed.split()):
                return spelling.modern(options)
    return list(words)


def _read(kinds: str, words: Sequence[str]) -> Options | None:
    """The options by their long names; None if there is anything else."""
    names = [kind.partition("/") for kind in kinds.split()]
    long = [name + ("=" if short.endswith("=") else "") for name, _, short in names]
    short = "".join(short.replace("=", ":") for _, _, short in names)
    full = {f"-{short[0]}": name for name, _, short in names} | {f"--{name}": name for name, _, _ in names}
    try:
        found, rest = getopt.getopt(list(words), short, long)
    except getopt.GetoptError:
        return None
    return None if rest else {full[option]: value for option, value in found}
