"""Substitutions in texts of XML, YAML and parameter files: `$(var NAME)` and others, also within one another."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from typing import Any

from endpoints.environment.launch.interpreter import substitutions as s
from endpoints.environment.launch.interpreter.context import Context, LaunchError

OPTIONAL = 1  # an argument that may be missing
MANY = 1000  # more arguments
MARK = 0xE000  # begin of the private characters, which stand for substitutions while a text is split
KINDS: dict[str, tuple[int, int, Callable[..., s.Substitution]]] = {
    "var": (1, OPTIONAL, lambda name, default=None: s.LaunchConfiguration(name, default=default)),
    "env": (1, OPTIONAL, lambda name, default=None: s.EnvironmentVariable(name, default_value=default)),
    "find-pkg-share": (1, 0, s.FindPackageShare),
    "find-pkg-prefix": (1, 0, s.FindPackagePrefix),
    "find-exec": (1, 0, lambda name: s.FindExecutable(name=name)),
    "dirname": (0, 0, s.ThisLaunchFileDir),
    "filename": (0, 0, s.ThisLaunchFile),
    "not": (1, 0, s.NotSubstitution),
    "and": (2, 0, s.AndSubstitution),
    "or": (2, 0, s.OrSubstitution),
    "all": (1, MANY, s.AllSubstitution),
    "any": (1, MANY, s.AnySubstitution),
    "equals": (2, 0, s.EqualsSubstitution),
    "not-equals": (2, 0, s.NotEqualsSubstitution),
    "if": (2, OPTIONAL, s.IfElseSubstitution),
}
"""Number of arguments, of optional ones, and what it makes."""


class _Deferred(s.Substitution):
    """`$(KIND …)`: its arguments are split after the substitutions within them."""

    def __init__(self, content: list[Any]) -> None:
        self.content = content

    def perform(self, context: Context) -> str:
        head = self.content[0] if self.content and isinstance(self.content[0], str) else ""
        kind, _, rest = head.lstrip().partition(" ")
        parts = [rest, *self.content[1:]] if rest else self.content[1:]
        if kind == "eval":
            return s.PythonExpression(_without_quotes(s.perform(context, parts))).perform(context)
        if kind not in KINDS:
            raise LaunchError(f"$({kind} …) is not supported; use one of {', '.join(sorted({*KINDS, 'eval'}))}")
        least, optional, make = KINDS[kind]
        given = _split(context, parts)
        if not least <= len(given) <= least + optional:
            raise LaunchError(f"$({kind} …) takes {least} arguments, not {len(given)}")
        return make(*given).perform(context)


def _split(context: Context, parts: Sequence[Any]) -> list[str]:
    return [s.perform(context, word) for word in split(parts)]


def split(parts: Sequence[Any]) -> list[list[Any]]:
    """Split strings and substitutions at spaces as a shell does; a substitution is never split.

    Raises:
        LaunchError: A quote has no end.
    """
    found = [part for part in parts if not isinstance(part, str)]
    marks = iter(range(len(found)))
    marked = "".join(part if isinstance(part, str) else chr(MARK + next(marks)) for part in parts)
    try:
        words = shlex.split(marked)
    except ValueError as error:
        raise LaunchError(f"{marked[:80]!r}: {error}") from None
    return [[found[ord(each) - MARK] if ord(each) - MARK in range(len(found)) else each for each in w] for w in words]


def _without_quotes(text: str) -> str:
    text = text.strip()
    if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"" and text.count(text[0]) == 2:
        return text[1:-1]
    return text


def parse(text: str) -> list[Any]:
    """Return the strings and substitutions of a text. A backslash before a dollar makes it a plain one.

    Raises:
        LaunchError: A substitution has no end.
    """
    parts, end = _parse(text, 0, nested=False)
    assert end == len(text)
    return parts


def _parse(text: str, at: int, nested: bool) -> tuple[list[Any], int]:
    parts: list[Any] = []
    plain, quote, depth = "", "", 0
    while at < len(text):
        letter = text[at]
        if text.startswith("\\$", at):
            plain, at = plain + "$", at + 2
        elif text.startswith("$(", at):
            content, at = _parse(text, at + 2, nested=True)
            parts += [plain, _Deferred(content)] if plain else [_Deferred(content)]
            plain = ""
        elif nested and letter == ")" and not quote and not depth:
            return ([*parts, plain] if plain else parts), at + 1
        else:
            if letter in "'\"" and quote in ("", letter):
                quote = "" if quote else letter
            elif not quote:
                depth += {"(": 1, ")": -1}.get(letter, 0)
            plain, at = plain + letter, at + 1
    if nested:
        raise LaunchError(f"a substitution in {text[:80]!r} has no closing parenthesis")
    return ([*parts, plain] if plain else parts), at
