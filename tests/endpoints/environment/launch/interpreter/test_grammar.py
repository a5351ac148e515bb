"""Substitutions in texts."""

from __future__ import annotations

from pathlib import Path

import pytest

from endpoints.environment.launch.interpreter import substitutions as s
from endpoints.environment.launch.interpreter.context import Context, LaunchError
from endpoints.environment.launch.interpreter.grammar import parse, split


@pytest.fixture
def context() -> Context:
    context = Context({"demo": "/opt/share/demo"}, {"x": "5", "words": "a b", "name": "x"})
    context.environment["V"] = "v"
    context.files = [Path("/opt/a.launch.xml")]
    return context


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("plain (text)", "plain (text)"),
        ("a$(var x)b", "a5b"),
        ("$(var none 9)", "9"),
        ("$(var none '')", ""),
        ("$(var $(var name))", "5"),
        ("$(env V)/$(env NONE w)", "v/w"),
        ("$(find-pkg-share demo)/a", "/opt/share/demo/a"),
        ("$(find-pkg-prefix demo)", "/opt"),
        ("$(dirname)/$(filename)", "/opt//opt/a.launch.xml"),
        ("$(eval '2 * $(var x)')", "10"),
        ("$(eval \"max(1, $(var x)) + len('$(var words)')\")", "8"),
        ("$(not true)", "false"),
        ("$(and true $(not false))", "true"),
        ("$(or false 0)", "false"),
        ("$(any false 0 true)", "true"),
        ("$(all true 1 false)", "false"),
        ("$(equals '$(var words)' 'a b')", "true"),
        ("$(not-equals $(var words) a)", "true"),
        ("$(if true a b)", "a"),
        (r"\$(var x)", "$(var x)"),
    ],
)
def test_text_has_value(context: Context, text: str, value: str) -> None:
    assert s.perform(context, parse(text)) == value


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("$(var x", "no closing parenthesis"),
        ("$(command ls)", "is not supported; use one of all, and, any, dirname, "),
        ("$(and true)", "takes 2 arguments, not 1"),
        ("$(var 'x)", "no closing parenthesis"),
    ],
)
def test_wrong_text_is_an_error(context: Context, text: str, message: str) -> None:
    with pytest.raises(LaunchError, match=message):
        s.perform(context, parse(text))


def test_words_are_split_before_their_substitutions(context: Context) -> None:
    words = split(parse("-a '$(var words) c' $(var words) $(eval '1 + 2')"))
    assert [s.perform(context, word) for word in words] == ["-a", "a b c", "a b", "3"]
    with pytest.raises(LaunchError, match="No closing quotation"):
        split(parse("'a"))
