"""What may stand next on a command line: words of commands, options, and names that the platform knows now."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

from rce import contexts, views
from rce.console import table
from rce.console.command import Argument, Command, Live, arguments_of
from rce.console.session import Session, whose
from rce.errors import RceError

PLATFORM_FLAGS = ("--url", "--user", "--context")
FRESH = 3.0  # seconds for which names are not asked for again
MOST = 1000  # names that are offered


class Within(NamedTuple):
    """Where names are looked for: in this environment, if it is complete, among the things of this user (empty: one's
    own, `*`: everybody's).
    """

    environment: str = ""
    owner: str = ""


class Names:
    """Names of things at the platform; none where it cannot be asked, since completion is no place for errors."""

    def __init__(self, session: Session, clock: Callable[[], float] = time.monotonic) -> None:
        self._session = session
        self._clock = clock
        self._known: dict[tuple[Live, Within], tuple[float, list[str]]] = {}

    def of(self, live: Live, words: Sequence[str] = ()) -> list[str]:
        """Those of a kind, of the user whom `--of` names; of topics and services, in the environment that `words` end
        with.
        """
        begun = words[-1].partition("/")[0] if words and live in ("topic", "service") else ""
        owner = next((whose(value) for flag, value in pairwise(words[:-1]) if flag == "--of"), "")
        key, now = (live, Within(begun, owner)), self._clock()
        if key not in self._known or now > self._known[key][0] + FRESH:
            self._known[key] = now, self._ask(*key)
        return self._known[key][1]

    def _ask(self, live: Live, within: Within) -> list[str]:
        try:
            return sorted(set(SOURCES[live](self._session, within))) if live in SOURCES else []
        except RceError:
            return []


def _environments(session: Session, within: Within) -> Iterable[str]:
    return (
        each.containerTag
        for each in session.api.items(views.EnvironmentView, "environments", limit=MOST, user=within.owner)
    )


def _robots(session: Session, within: Within) -> Iterable[str]:
    return (each.robotID for each in session.api.items(views.RobotView, "robots", limit=MOST, user=within.owner))


def _endpoints(session: Session, within: Within) -> Iterable[str]:
    return [*_environments(session, within), *_robots(session, within)]


def _interfaces(session: Session, within: Within) -> Iterable[str]:
    found = session.api.items(views.InterfaceView, "interfaces", limit=MOST, user=within.owner)
    return (f"{each.endpointTag}/{each.interfaceTag}" for each in found)


def _types(session: Session, within: Within) -> Iterable[str]:
    return (
        each.className for each in session.api.items(views.InterfaceView, "interfaces", limit=MOST, user=within.owner)
    )


def _groups(session: Session, within: Within) -> Iterable[str]:
    return (each.group for each in session.api.items(views.GroupView, "groups", limit=MOST, user=within.owner))


def _machines(session: Session, _: Within) -> Iterable[str]:
    return (each.name for each in session.api.items(views.MachineView, "machines", limit=MOST))


def _users(session: Session, _: Within) -> Iterable[str]:
    return (each.name for each in session.api.items(views.UserView, "users", limit=MOST))


def _keys(session: Session, within: Within) -> Iterable[str]:
    return (each.id for each in session.api.items(views.KeyView, "keys", limit=MOST, user=within.owner))


def _topics(session: Session, within: Within) -> Iterable[str]:
    return _in_environment(session, within, "topics")


def _services(session: Session, within: Within) -> Iterable[str]:
    return _in_environment(session, within, "services")


def _in_environment(session: Session, within: Within, kind: str) -> Iterable[str]:
    """`ENV/` for each environment, and all of one when its name is complete."""
    known = list(_environments(session, within))
    if within.environment not in known:
        return [f"{each}/" for each in known]
    found = session.api.items(views.RosName, "environments", within.environment, kind, user=within.owner)
    return [f"{within.environment}{each.name}" for each in found]


SOURCES: dict[Live, Callable[[Session, Within], Iterable[str]]] = {
    "context": lambda _, __: contexts.load().contexts,
    "endpoint": _endpoints,
    "environment": _environments,
    "group": _groups,
    "interface": _interfaces,
    "key": _keys,
    "machine": _machines,
    "robot": _robots,
    "service": _services,
    "topic": _topics,
    "type": _types,
    "user": _users,
}


def candidates(words: Sequence[str], names: Names, platform: bool = True) -> dict[str, str]:
    """What may stand in the place of the last of `words`, which may be begun or empty, with a word of help each."""
    before, begun = list(words[:-1]), words[-1] if words else ""
    found = _all(before, begun, names, platform)
    return {word: text for word, text in found.items() if word.startswith(begun)}


def _all(before: list[str], begun: str, names: Names, platform: bool) -> dict[str, str]:
    command, rest = table.find(before)
    if command is None:
        return _words(before)
    named = command.name.split()
    if len(before) == len(named) == 1 and len(table.below(named[0])) > 1:
        return _words(before) | _following(command, rest, begun, names, platform)
    return _following(command, rest, begun, names, platform)


def _words(before: list[str]) -> dict[str, str]:
    if not before:
        return {word: _about(word) for word in table.WORDS}
    second = (command.name.partition(" ") for command in table.below(before[0]))
    return (
        {name: table.COMMANDS[f"{first} {name}"].help for first, _, name in second if name} if len(before) == 1 else {}
    )


def _about(word: str) -> str:
    found = table.below(word)
    return found[0].help if len(found) == 1 else ", ".join(command.name.partition(" ")[2] for command in found)


def _following(command: Command, rest: list[str], begun: str, names: Names, platform: bool) -> dict[str, str]:
    arguments = arguments_of(command, platform)
    option = _option(arguments, rest[-1]) if rest else None
    if option is not None and _takes_value(option):
        return _values(option, rest, begun, names, platform)
    if begun.startswith("-"):
        options = (each for each in arguments if not each.positional)
        return {flag: str(each.options.get("help", "")) for each in options for flag in each.flags if flag not in rest}
    place = _positionals(arguments, rest)
    return _values(place, rest, begun, names, platform) if place else {}


def _option(arguments: Sequence[Argument], word: str) -> Argument | None:
    return next((each for each in arguments if not each.positional and word in each.flags), None)


def _takes_value(option: Argument) -> bool:
    return "action" not in option.options or option.options["action"] == "append"


def _positionals(arguments: Sequence[Argument], rest: list[str]) -> Argument | None:
    """The positional argument that comes next."""
    count = 0
    skip = False
    for word in rest:
        option = _option(arguments, word)
        if not skip and option is None and not word.startswith("-"):
            count += 1
        skip = option is not None and _takes_value(option)
    places = [each for each in arguments if each.positional]
    if places and count >= len(places) and places[-1].options.get("nargs") in ("*", "+", "..."):
        return places[-1]
    return places[count] if count < len(places) else None


def _values(argument: Argument, rest: list[str], begun: str, names: Names, platform: bool) -> dict[str, str]:
    if argument.live == "words":
        return _all(rest, begun, names, platform)
    if "choices" in argument.options:
        return {str(choice): "" for choice in argument.options["choices"]}
    return dict.fromkeys(names.of(argument.live, [*rest, begun]), "")


def complete(words: Sequence[str]) -> int:
    """`rce complete`, which the scripts of `rce completion` ask: what may stand in the place of the last word."""
    named = {flag: words[at + 1] for at, flag in enumerate(words[:-1]) if flag in PLATFORM_FLAGS}
    session = Session(*(named.get(flag, "") for flag in PLATFORM_FLAGS))
    for word, text in sorted(candidates(words or [""], Names(session)).items()):
        print(f"{word}\t{text}" if text else word)
    return 0
