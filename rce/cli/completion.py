"""Completion of command lines: words of commands, options, and names that the platform knows at present."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

from rce.api import views
from rce.cli import contexts, table
from rce.cli.arguments import Argument, Completion
from rce.cli.command import Command
from rce.cli.session import ConsoleSession, user_query
from rce.errors import RceError

PLATFORM_OPTIONS = ("--url", "--user", "--context")
CACHE_SECONDS = 3.0
MAX_NAMES = 1000


class Scope(NamedTuple):
    """Scope of a lookup of names.

    `owner` is the user who owns the objects: empty for the session's user, `*` for all users. `environment` narrows
    topics, services and actions, if it is the complete name of an environment. Packages and executables are those in
    it, and executables those of `package`.
    """

    environment: str = ""
    owner: str = ""
    package: str = ""


class Names:
    """Names of objects at the platform, cached for some seconds.

    There are none while the platform cannot be reached: completion must not print errors.
    """

    def __init__(self, session: ConsoleSession, clock: Callable[[], float] = time.monotonic) -> None:
        self._session = session
        self._clock = clock
        self._cache: dict[tuple[Completion, Scope], tuple[float, list[str]]] = {}

    def find(self, kind: Completion, words: Sequence[str] = ()) -> list[str]:
        """Return the names of a kind that may complete the last of `words`.

        They are those of the user that --of names in the line. Topics, services and actions are those of the
        environment that the last word begins with, packages and executables those of the one that the first word names.
        """
        environment = package = ""
        if words and kind in ("topic", "service", "action"):
            environment = words[-1].partition("/")[0]
        elif len(words) > 1 and kind in ("package", "executable"):
            environment, package = words[0], words[-2] if kind == "executable" else ""
        owner = next((user_query(value) for flag, value in pairwise(words[:-1]) if flag == "--of"), "")
        key, now = (kind, Scope(environment, owner, package)), self._clock()
        if key not in self._cache or now > self._cache[key][0] + CACHE_SECONDS:
            self._cache[key] = now, self._request(*key)
        return self._cache[key][1]

    def _request(self, kind: Completion, scope: Scope) -> list[str]:
        try:
            return sorted(set(SOURCES[kind](self._session, scope))) if kind in SOURCES else []
        except RceError:
            return []


def _environments(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    found = session.api.items(views.EnvironmentView, "environments", limit=MAX_NAMES, user=scope.owner)
    return (each.containerTag for each in found)


def _robots(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    found = session.api.items(views.RobotView, "robots", limit=MAX_NAMES, user=scope.owner)
    return (each.robotID for each in found)


def _endpoints(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    return [*_environments(session, scope), *_robots(session, scope)]


def _interfaces(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    found = session.api.items(views.InterfaceView, "interfaces", limit=MAX_NAMES, user=scope.owner)
    return (f"{each.endpointTag}/{each.interfaceTag}" for each in found)


def _types(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    found = session.api.items(views.InterfaceView, "interfaces", limit=MAX_NAMES, user=scope.owner)
    return (each.className for each in found)


def _groups(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    return (each.group for each in session.api.items(views.GroupView, "groups", limit=MAX_NAMES, user=scope.owner))


def _machines(session: ConsoleSession, _: Scope) -> Iterable[str]:
    return (each.name for each in session.api.items(views.MachineView, "machines", limit=MAX_NAMES))


def _users(session: ConsoleSession, _: Scope) -> Iterable[str]:
    return (each.name for each in session.api.items(views.UserView, "users", limit=MAX_NAMES))


def _keys(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    return (each.id for each in session.api.items(views.KeyView, "keys", limit=MAX_NAMES, user=scope.owner))


def _topics(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    return _in_environment(session, scope, "topics")


def _services(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    return _in_environment(session, scope, "services")


def _actions(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    return _in_environment(session, scope, "actions")


def _in_environment(session: ConsoleSession, scope: Scope, kind: str) -> Iterable[str]:
    """Return `ENV/` for each environment, or all names in one environment once its own name is complete."""
    environments = list(_environments(session, scope))
    if scope.environment not in environments:
        return [f"{each}/" for each in environments]
    found = session.api.items(views.RosName, "environments", scope.environment, kind, user=scope.owner)
    return [f"{scope.environment}{each.name}" for each in found]


def _packages(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    return (each.name for each in _ros_packages(session, scope))


def _executables(session: ConsoleSession, scope: Scope) -> Iterable[str]:
    found = (each for each in _ros_packages(session, scope) if each.name == scope.package)
    return (name for each in found for name in each.executables)


def _ros_packages(session: ConsoleSession, scope: Scope) -> Iterable[views.RosPackage]:
    path = ("environments", scope.environment, "packages")
    return session.api.items(views.RosPackage, *path, user=scope.owner) if scope.environment else []


SOURCES: dict[Completion, Callable[[ConsoleSession, Scope], Iterable[str]]] = {
    "action": _actions,
    "context": lambda _, __: contexts.load().contexts,
    "endpoint": _endpoints,
    "environment": _environments,
    "executable": _executables,
    "group": _groups,
    "interface": _interfaces,
    "key": _keys,
    "machine": _machines,
    "package": _packages,
    "robot": _robots,
    "service": _services,
    "topic": _topics,
    "type": _types,
    "user": _users,
}


def candidates(words: Sequence[str], names: Names, in_console: bool = False) -> dict[str, str]:
    """Return the completions of the last of `words`, with a line of help each (empty for names).

    Args:
        words: The words of the line up to the cursor; the last is the incomplete one, empty after a blank.
        names: Names at the platform.
        in_console: True for a line of the interactive console, which has fewer commands and no platform options.
    """
    before, prefix = list(words[:-1]), words[-1] if words else ""
    found = _all_candidates(before, prefix, names, in_console)
    return {word: text for word, text in found.items() if word.startswith(prefix)}


def _all_candidates(before: list[str], prefix: str, names: Names, in_console: bool) -> dict[str, str]:
    if not before:
        return {word: table.summary(word, in_console) for word in table.first_words(in_console)}
    second = table.second_words(before[0], in_console) if len(before) == 1 else {}
    command, arguments = table.find_command(before, in_console)
    if command is None:
        return second
    return second | _argument_candidates(command, arguments, prefix, names, in_console)


def _argument_candidates(
    command: Command, before: list[str], prefix: str, names: Names, in_console: bool
) -> dict[str, str]:
    """Return what may follow the arguments `before` of a command."""
    arguments = command.all_arguments(in_console)
    option = _option(arguments, before[-1]) if before else None
    if option is not None and option.takes_value:
        return _values(option, before, prefix, names, in_console)
    if prefix.startswith("-"):
        options = (each for each in arguments if not each.positional)
        return {
            flag: str(each.options.get("help", "")) for each in options for flag in each.flags if flag not in before
        }
    positional = _next_positional(arguments, before)
    return _values(positional, before, prefix, names, in_console) if positional else {}


def _option(arguments: Sequence[Argument], word: str) -> Argument | None:
    return next((each for each in arguments if not each.positional and word in each.flags), None)


def _next_positional(arguments: Sequence[Argument], before: list[str]) -> Argument | None:
    count = 0
    skip = False
    for word in before:
        option = _option(arguments, word)
        if not skip and option is None and not word.startswith("-"):
            count += 1
        skip = option is not None and option.takes_value
    positionals = [each for each in arguments if each.positional]
    if positionals and count >= len(positionals) and positionals[-1].options.get("nargs") in ("*", "+", "..."):
        return positionals[-1]
    return positionals[count] if count < len(positionals) else None


def _values(argument: Argument, before: list[str], prefix: str, names: Names, in_console: bool) -> dict[str, str]:
    if argument.completion in ("command", "console command"):
        console_only = in_console or argument.completion == "console command"
        return _all_candidates(before, prefix, names, console_only)
    if "choices" in argument.options:
        return {str(choice): "" for choice in argument.options["choices"]}
    return dict.fromkeys(names.find(argument.completion, [*before, prefix]), "")


def complete(words: Sequence[str]) -> int:
    """Run `rce complete`, which the scripts of `rce completion` call: print the completions of the last word."""
    options = {flag: words[at + 1] for at, flag in enumerate(words[:-1]) if flag in PLATFORM_OPTIONS}
    session = ConsoleSession(*(options.get(flag, "") for flag in PLATFORM_OPTIONS))
    for word, text in sorted(candidates(words or [""], Names(session)).items()):
        print(f"{word}\t{text}" if text else word)
    return 0
