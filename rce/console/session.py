"""What commands have in common while they run: the platform, and who asks there."""

from __future__ import annotations

import argparse
import secrets
from functools import cached_property
from typing import TYPE_CHECKING

from rce import contexts
from rce.api import Api
from rce.contexts import Access
from rce.names import GUEST

if TYPE_CHECKING:  # a second that most commands can do without
    from rce.client import Robot


class Session:
    """The platform that a command line names; looked up when it is first needed."""

    def __init__(self, url: str = "", user: str = "", context: str = "") -> None:
        self._named = (url, user, context)

    @classmethod
    def of(cls, words: argparse.Namespace) -> Session:
        return cls(getattr(words, "url", ""), getattr(words, "user", ""), getattr(words, "context", ""))

    @cached_property
    def access(self) -> Access:
        """Unauthorized if nothing says where to go or who asks."""
        return contexts.access(*self._named)

    @cached_property
    def api(self) -> Api:
        access = self.access
        return Api(access.url, user=access.user, password=access.password, key=access.key)

    @cached_property
    def user(self) -> str:
        """Who asks: a key knows its user."""
        from rce.views import Whoami

        return self.access.user or self.api.get(Whoami, "whoami").user

    def guest(self, owner: str) -> Robot:
        """A guest of `owner` (empty: of who asks), by which the console takes part in topics and services."""
        from rce.client import Robot

        access = self.access
        name = f"{GUEST}console_{secrets.token_hex(3)}"
        return Robot(access.url, user=self.user, robot=name, password=access.password, key=access.key, owner=owner)

    def use(self, context: str) -> None:
        """From now on the platform of this context."""
        self._named = ("", "", context)
        self.forget()

    def forget(self) -> None:
        """The next command looks for its platform anew: somebody has signed in, or out."""
        for name in ("access", "api", "user"):
            self.__dict__.pop(name, None)


def whose(of: str) -> str:
    """`?user=` for `--of`: `all` is everybody."""
    return "*" if of == "all" else of
