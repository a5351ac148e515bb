"""Decoder of join codes, without verification (see rce/api/joining.py). Standard library only."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass

from provisioning.steps import ProvisioningError

PREFIX = "rce1-"


@dataclass(frozen=True)
class Code:
    """A join code and the parts of it that concern the installation.

    Attributes:
        text: The code.
        url: The Master's URL for machines that join.
        name: Name of the new machine.
        roles: Roles that it may have.
    """

    text: str
    url: str
    name: str
    roles: tuple[str, ...]


def parse(text: str) -> Code:
    """Decode a join code.

    Raises:
        ProvisioningError: The text is not a join code.
    """
    body = "".join(text.split()).removeprefix(PREFIX)
    try:
        content = json.loads(base64.urlsafe_b64decode(body + "=" * (-len(body) % 4)))
        invitation = content["invitation"]
        return Code(text, str(content["url"]), str(invitation["name"]), tuple(map(str, invitation["roles"])))
    except (ValueError, KeyError, TypeError):
        raise ProvisioningError(
            "this is not a complete join code: copy the whole line that `provision machine add` printed"
        ) from None
