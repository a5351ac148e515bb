"""WebSockets of the platform's gateways."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote, urlencode, urlsplit, urlunsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidHandshake, InvalidStatus
from websockets.typing import Subprotocol

from rce.api.http import is_local
from rce.client.address import OPEN_TIMEOUT, Address
from rce.errors import Unavailable
from rce.protocol.assembler import AssemblyLimits


async def dial_gateway(
    address: Address,
    protocol: str,
    environment: str,
    subprotocols: Sequence[Subprotocol] | None = None,
    options: Sequence[tuple[str, str]] = (),
) -> ClientConnection:
    """Open a WebSocket of a gateway of the platform, whose messages are those of the protocol.

    Args:
        address: Platform and credentials.
        protocol: `rosbridge` or `foxglove`.
        environment: Tag of an environment of the address's `owner`.
        subprotocols: Subprotocols to offer.
        options: Options of the gateway, by name.

    Raises:
        Unavailable: The gateway cannot be reached, or refuses the connection.
        RceError: The entry refuses the request, for example an unknown user.
    """
    endpoint = await address.locate()
    parts = urlsplit(endpoint)
    path = "/".join([parts.path.rstrip("/"), protocol, *filter(None, (quote(address.owner), quote(environment)))])
    query = urlencode([("userID", address.user), *address.secret.items(), *options])
    uri = urlunsplit((parts.scheme, parts.netloc, path, query, ""))
    try:
        return await connect(
            uri,
            ssl=(address.ssl or True) if parts.scheme == "wss" else None,
            subprotocols=subprotocols,
            proxy=None if is_local(endpoint) else True,
            compression=None,
            open_timeout=OPEN_TIMEOUT,
            max_size=AssemblyLimits().message * 2,
        )
    except InvalidStatus as error:
        text = error.response.body.decode(errors="replace").strip() or error.response.reason_phrase
        raise Unavailable(f"the gateway refuses the connection: {error.response.status_code} {text}") from None
    except (OSError, TimeoutError, InvalidHandshake) as error:
        raise Unavailable(f"cannot reach {endpoint}: {str(error) or 'no answer'}") from None
