"""Calls by which environments use the knowledge service."""

from __future__ import annotations

from rce.api.knowledge_requests import KnowledgeAnswer, KnowledgeRequest
from rce.control.calls.call import Call

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
