"""Arguments of commands, and those that several commands share."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

Completion = Literal[
    "",
    "action",
    "command",
    "console command",
    "context",
    "endpoint",
    "environment",
    "executable",
    "group",
    "interface",
    "key",
    "machine",
    "package",
    "robot",
    "service",
    "topic",
    "type",
    "user",
]
"""Kind of names that completion offers for an argument; with `command` and `console command` a command line follows."""


class Argument(NamedTuple):
    """Argument of a command line, with the flags and options of `argparse.ArgumentParser.add_argument`."""

    flags: tuple[str, ...]
    completion: Completion
    options: dict[str, Any]

    @property
    def positional(self) -> bool:
        """True unless the argument is an option."""
        return not self.flags[0].startswith("-")

    @property
    def takes_value(self) -> bool:
        """True unless the argument is a flag, as --json is."""
        return self.options.get("action", "store") in ("store", "append")


class PlatformOptions(NamedTuple):
    """Options that select the platform and the credentials; a group of their own in a command's help."""

    arguments: tuple[Argument, ...]
    description: str | None = None


def argument(*flags: str, completion: Completion = "", **options: Any) -> Argument:
    """Return an argument; `options` are those of argparse."""
    return Argument(flags, completion, options)


DEV_USER = "testUser"
"""User, and their password, of platforms started with --dev."""
LOCAL_URL = "http://127.0.0.1:9000/"
ENGINES = ("process", "docker", "swarm")

JSON = argument("--json", action="store_true", help="print JSON instead of a table")
OF_USER = argument("--of", completion="user", default="", metavar="USER", help="another user's; needs the permission")
OF_USER_OR_ALL = argument(
    "--of", completion="user", default="", metavar="USER|all", help="another user's, or all users'"
)
ENVIRONMENT = argument("environment", completion="environment", metavar="ENV", help="its containerTag")

_CONTEXT = argument(
    "--context", completion="context", default="", metavar="NAME", help="a platform you are signed in to"
)
_USER = argument(
    "--user", default="", metavar="NAME", help=f"(default: as you are signed in, else {DEV_USER} on this machine)"
)
_PASSWORD = argument("--password", default=None, help="safer: set RCE_PASSWORD or RCE_KEY in the environment")

SIGNED_IN = PlatformOptions(
    (
        _CONTEXT,
        argument("--url", default="", help="entry of a platform, http://host:9000/, with RCE_KEY or RCE_PASSWORD"),
        argument("--user", default="", metavar="NAME", help="your user name there, with --url"),
    ),
    "(default: the current context; see `rce context`)",
)
"""For commands at the platform of the current context."""

RUNNING = PlatformOptions(
    (
        _CONTEXT,
        argument("--url", default="", help=f"its entry (default: the current context, else {LOCAL_URL})"),
        _USER,
        _PASSWORD,
    )
)
"""For commands that need a running platform, a development platform on this machine included."""

RUNNING_OR_OWN = PlatformOptions(
    (
        argument("--url", default="", help="entry of a running platform, http://host:9000/"),
        _USER,
        _PASSWORD,
        argument("--engine", choices=ENGINES, default="process", help="engine of the started platform"),
    ),
    "without --url, a platform is started for this command alone",
)
"""For commands that start a platform for themselves unless they are given one."""
