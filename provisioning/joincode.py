"""What a join code says, for the plan; its meaning is in rce/joining.py. Standard library only."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass

from provisioning.steps import Failed

PREFIX = "rce1-"


@dataclass(frozen=True)
class Code:
    """A code as it was pasted, and what concerns the installation."""

    text: str
    url: str
    name: str
    roles: tuple[str, ...]


def parse(text: str) -> Code:
    body = "".join(text.split()).removeprefix(PREFIX)
    try:
        content = json.loads(base64.urlsafe_b64decode(body + "=" * (-len(body) % 4)))
        invitation = content["invitation"]
        return Code(text, str(content["url"]), str(invitation["name"]), tuple(map(str, invitation["roles"])))
    except (ValueError, KeyError, TypeError):
        raise Failed(
            "this is no join code, or not all of it: paste the whole line that `provision machine add` printed"
        ) from None
