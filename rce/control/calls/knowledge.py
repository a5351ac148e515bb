"""Calls by which environments use the knowledge service."""

from __future__ import annotations

from msgspec import Struct

from rce.api.knowledge import Action, Kind
from rce.api.knowledge_requests import KnowledgeAnswer, KnowledgeRequest
from rce.control.calls.call import Call, Nothing

SERVICE = "knowledge-service"  # the Master finds the service by this name


class AskKnowledge(Call[KnowledgeAnswer], frozen=True):
    """Request of a program in an environment, with the rights of the owner of the environment.

    Raises Forbidden, LimitExceeded, Unavailable, and what the service raises.
    """

    request: KnowledgeRequest


class AnswerKnowledge(Call[KnowledgeAnswer], frozen=True):
    """Answer a request of an environment, `user/tag`. The Master has checked the rights of its owner."""

    environment: str
    request: KnowledgeRequest


class NotedChange(Struct, frozen=True):
    """Change of an entry, for the feed of the Master. `user` made it; `public` entries concern everybody."""

    action: Action
    kind: Kind
    uid: str
    author: str
    user: str
    public: bool


class ReportChanges(Call[Nothing], frozen=True):
    """Report changes of entries to the Master, in their order."""

    changes: list[NotedChange]
