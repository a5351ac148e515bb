"""`secret`: texts that nodes get as files or variables, and that nobody is shown again."""

from __future__ import annotations

import argparse
import getpass
import sys
from pathlib import Path

from rce.api import views
from rce.cli import output
from rce.cli.arguments import JSON, argument
from rce.cli.command import Command
from rce.cli.session import ConsoleSession
from rce.errors import InvalidRequest, describe_os_error

NAME = argument("name", metavar="NAME")
SECRETS: output.Columns[views.SecretView] = {
    "secret": lambda each: each.name,
    "set": lambda each: output.local_time(each.created),
}


def _set(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.post(views.SecretView, "secrets", body=views.NewSecret(args.name, _value(args.file)))


def _value(file: Path | None) -> str:
    """Return the secret: the content of a file, what is typed unseen, or standard input without its last line end."""
    try:
        if file is not None:
            return file.read_text(encoding="utf-8")
        if sys.stdin.isatty():
            return getpass.getpass("secret: ")
        return sys.stdin.read().removesuffix("\n")
    except OSError as error:
        raise InvalidRequest(describe_os_error(error)) from None
    except UnicodeDecodeError:
        raise InvalidRequest("a secret is a text in UTF-8: encode other contents, for example as base64") from None


def _list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(session.api.items(views.SecretView, "secrets"), SECRETS, args.json)


def _remove(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.delete("secrets", args.name)


COMMANDS = (
    Command(
        "secret set",
        "Set a secret of yours from standard input or a file; it is never shown again.",
        _set,
        (NAME, argument("--file", type=Path, default=None, metavar="FILE")),
        ("secret set database --file password.txt",),
        description="Environments get it by the option `secrets` of containerData, as a file in $RCE_SECRETS_DIR and, "
        "if the option says so, as a variable.",
    ),
    Command("secret list", "List the names of your secrets.", _list, (JSON,)),
    Command("secret remove", "Remove a secret; environments that run keep it.", _remove, (NAME,)),
)
