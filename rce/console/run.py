"""One command line of the console: found in the table, parsed, carried out; errors as text with an exit status."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rce.console import table
from rce.console.command import Usage, parser
from rce.console.original import modern
from rce.console.session import Session
from rce.errors import RceError, reason

DONE, FAILED, WRONG, STOPPED = 0, 1, 2, 130


def run(words: Sequence[str], session: Session | None = None) -> int:
    """The exit status: 0 done; 1 failed, the reason is on standard error; 2 the words are wrong; 130 Ctrl-C.

    In a console the `session` is the console's, else the words say where the platform is.
    """
    prog = "" if session else "rce "
    try:
        return _carry_out(modern(words), session)
    except Usage as error:
        return _refuse(f"{prog}{error}", WRONG)
    except RceError as error:
        return _refuse(f"{prog.rstrip() or words[0]}: {error}", FAILED)
    except OSError as error:
        if error.filename is None:  # not a file that was named, but a pipe that nobody reads
            raise
        return _refuse(f"{prog.rstrip() or words[0]}: {reason(error)}", FAILED)
    except KeyboardInterrupt:
        return STOPPED
    except SystemExit as error:  # argparse, after --help
        return int(error.code or 0)


def _carry_out(words: Sequence[str], session: Session | None) -> int:
    prog = "" if session else "rce"
    command, arguments = table.find(words)
    if command is None:
        return _unknown(words, prog)
    parsed = parser(command, prog, platform=session is None).parse_args(arguments)
    return command.run(session or Session.of(parsed), parsed) or DONE


def _unknown(words: Sequence[str], prog: str) -> int:
    word, rest = words[0], words[1:]
    known = table.below(word)
    if not known:
        return _refuse(
            f"{prog or 'console'}: there is no command {word!r}; `{f'{prog} help'.lstrip()}` lists them", WRONG
        )
    text = table.usage_of(word, prog)
    if not rest or rest[0] in ("-h", "--help", "help"):
        print(text)
        return DONE if rest else WRONG
    return _refuse(f"there is no command `{word} {rest[0]}`\n\n{text}", WRONG)


def _refuse(text: str, status: int) -> int:
    print(text, file=sys.stderr)
    return status
