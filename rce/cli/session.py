"""State that commands share while they run: the platform, and the credentials used there."""

from __future__ import annotations

import argparse
import secrets
from functools import cached_property
from typing import TYPE_CHECKING

from rce.api.client import ApiClient
from rce.cli import contexts
from rce.cli.contexts import Access
from rce.protocol.names import GUEST_PREFIX

if TYPE_CHECKING:  # takes a second to import, which most commands do not need
    from rce.client import Robot


class ConsoleSession:
    """The platform that a command line or a console selects, looked up when it is first needed.

    `in_console` is True in the interactive console and its scripts, whose commands take no options for the platform.
    """

    def __init__(self, url: str = "", user: str = "", context: str = "") -> None:
        self.in_console = False
        self._selection = (url, user, context)

    @classmethod
    def from_arguments(cls, args: argparse.Namespace) -> ConsoleSession:
        """Return the session for the platform options of a parsed command line."""
        return cls(getattr(args, "url", ""), getattr(args, "user", ""), getattr(args, "context", ""))

    @cached_property
    def access(self) -> Access:
        """Entry and credentials.

        Raises:
            Unauthorized: Neither options, environment variables nor a context give credentials.
            NotFound: There is no context of this name.
        """
        return contexts.access(*self._selection)

    @cached_property
    def api(self) -> ApiClient:
        """Client of the HTTP API."""
        access = self.access
        return ApiClient(access.url, user=access.user, password=access.password, key=access.key)

    @cached_property
    def user(self) -> str:
        """Name of the authenticated user; for an API key, the platform is asked."""
        from rce.api.views import Whoami

        return self.access.user or self.api.get(Whoami, "whoami").user

    def guest(self, owner: str) -> Robot:
        """Return a guest robot, not yet connected, for environments of `owner` (empty: of the session's user)."""
        from rce.client import Robot

        access = self.access
        name = f"{GUEST_PREFIX}console_{secrets.token_hex(3)}"
        return Robot(access.url, user=self.user, robot=name, password=access.password, key=access.key, owner=owner)

    def use_context(self, context: str) -> None:
        """Select the platform of this context for the commands that follow."""
        self._selection = ("", "", context)
        self.forget_access()

    def forget_access(self) -> None:
        """Have the next command look up platform and credentials again, after a login or logout."""
        for name in ("access", "api", "user"):
            self.__dict__.pop(name, None)


def user_query(of: str) -> str:
    """Return the value of the API's query parameter `user` for the option --of: `*` for `all`."""
    return "*" if of == "all" else of
