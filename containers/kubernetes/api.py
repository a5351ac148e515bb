"""Access to the API server of a Kubernetes cluster.

The library finds the cluster and its credentials, renews them, and sends the requests. Objects are JSON as the API
defines it, since the library's own classes are those of one version of Kubernetes.
"""

from __future__ import annotations

import json
import os
from collections.abc import AsyncIterator, Mapping

import aiohttp
import msgspec
from kubernetes_asyncio.client import ApiClient, Configuration
from kubernetes_asyncio.config import ConfigException, load_incluster_config, load_kube_config
from msgspec import Struct

from containers.kubernetes.objects import Object
from rce.errors import MALFORMED, NotFound, Unavailable

FIELD_MANAGER = "rce"  # owner of the fields that `apply` sets
APPLY = "application/apply-patch+yaml"  # server-side apply; JSON is YAML
TIMEOUT = aiohttp.ClientTimeout(total=60)
CONNECT_TIMEOUT = 20.0  # seconds
WATCH_SECONDS = 240  # after which the API server ends a watch, which then begins again
GONE, CONFLICT = 410, 409
IN_CLUSTER = "KUBERNETES_SERVICE_HOST"  # variable that every pod has
USUAL = "~/.kube/config"


class Refused(Unavailable):
    """The API server refused a request; `status` is that of HTTP."""

    def __init__(self, message: str, status: int = 0) -> None:
        super().__init__(message)
        self.status = status


class Event(Struct, frozen=True):
    """A change of an object: `type` is ADDED, MODIFIED, DELETED or BOOKMARK."""

    type: str
    object: Object


class Api:
    """The API server that KUBECONFIG names, or else that of the cluster in which this process is a pod.

    All calls raise Unavailable if it does not answer, Refused if it refuses, and NotFound if there is no such object.
    """

    def __init__(self) -> None:
        self._client: ApiClient

    async def open(self) -> None:
        """Find the cluster.

        Raises:
            Unavailable: There is no configuration of a cluster, or it is not valid.
        """
        configuration = Configuration()
        try:
            if "KUBECONFIG" in os.environ or IN_CLUSTER not in os.environ:
                await load_kube_config(os.environ.get("KUBECONFIG") or USUAL, client_configuration=configuration)
            else:
                load_incluster_config(configuration)
        except (ConfigException, OSError) as error:
            raise Unavailable(
                f"no Kubernetes cluster is configured ({error}): run in a pod with a service account, or set KUBECONFIG"
            ) from None
        self._client = ApiClient(configuration)

    async def close(self) -> None:
        """Close all connections."""
        if hasattr(self, "_client"):
            await self._client.close()

    async def get(self, path: str, **query: str) -> Object:
        """Read an object or a list."""
        return await self._json("GET", path, query)

    async def create(self, path: str, body: Object) -> Object:
        """Create an object in a collection."""
        return await self._json("POST", path, {}, body)

    async def apply(self, path: str, body: Object) -> Object:
        """Create an object or set the fields that `body` names."""
        return await self._json("PATCH", path, {"fieldManager": FIELD_MANAGER, "force": "true"}, body, APPLY)

    async def delete(self, path: str, grace: int | None = None, uid: str = "") -> bool:
        """Delete an object, which may end after `grace` seconds; with `uid`, only that very one.

        Returns:
            False if there is no such object.
        """
        body: Object = {"propagationPolicy": "Background"}
        if grace is not None:
            body["gracePeriodSeconds"] = grace
        if uid:
            body["preconditions"] = {"uid": uid}
        try:
            await self._json("DELETE", path, {}, body)
        except NotFound:
            return False
        except Refused as error:
            if error.status != CONFLICT:
                raise
            return False  # another object has taken its name
        return True

    async def text(self, path: str, **query: str) -> str:
        """Read something that is not JSON."""
        response = await self._send("GET", path, query, None, TIMEOUT)
        try:
            return await response.text(errors="replace")
        except aiohttp.ClientError as error:
            raise Unavailable(f"Kubernetes does not answer: {error}") from None
        finally:
            response.release()

    async def watch(self, path: str, version: str, **query: str) -> AsyncIterator[Event]:
        """Yield the changes of the objects in a collection after a version of it; end when the API server ends it.

        Raises:
            Refused: The version is too old (status 410): list again.
        """
        query |= {"watch": "true", "resourceVersion": version, "allowWatchBookmarks": "true"}
        query["timeoutSeconds"] = str(WATCH_SECONDS)
        timeout = aiohttp.ClientTimeout(connect=CONNECT_TIMEOUT, sock_read=WATCH_SECONDS + CONNECT_TIMEOUT)
        response = await self._send("GET", path, query, None, timeout)
        try:
            async for line in _lines(response.content):
                event = msgspec.json.decode(line, type=Event)
                if event.type == "ERROR":
                    raise Refused(str(event.object.get("message")), int(event.object.get("code", 0)))
                yield event
        except (aiohttp.ClientError, TimeoutError, *MALFORMED) as error:
            raise Unavailable(f"Kubernetes does not answer: {error!r}") from None
        finally:
            response.close()

    async def _json(
        self, method: str, path: str, query: Mapping[str, str], body: Object | None = None, kind: str = ""
    ) -> Object:
        response = await self._send(method, path, query, body, TIMEOUT, kind)
        try:
            found: Object = await response.json()
        except (aiohttp.ClientError, TimeoutError, ValueError) as error:
            raise Unavailable(f"Kubernetes does not answer: {error!r}") from None
        finally:
            response.release()
        return found

    async def _send(
        self,
        method: str,
        path: str,
        query: Mapping[str, str],
        body: Object | None,
        bounds: aiohttp.ClientTimeout,
        kind: str = "",
    ) -> aiohttp.ClientResponse:
        headers = {"Accept": "application/json, */*", "Content-Type": kind or "application/json"}
        try:
            response: aiohttp.ClientResponse = await self._client.call_api(
                path,
                method,
                query_params=list(query.items()),
                header_params=headers,
                body=body,
                auth_settings=["BearerToken"],
                _preload_content=False,
                _request_timeout=bounds,
            )
        except (aiohttp.ClientError, TimeoutError, OSError) as error:
            raise Unavailable(f"Kubernetes does not answer: {error!r}") from None
        if response.status < 300:
            return response
        try:
            message = _message(await response.text(errors="replace"))
        except (aiohttp.ClientError, TimeoutError) as error:
            raise Unavailable(f"Kubernetes does not answer: {error!r}") from None
        finally:
            response.release()
        if response.status == 404:
            raise NotFound(f"Kubernetes: {message}")
        raise Refused(f"Kubernetes refuses {method} {path}: {message}", response.status)


async def _lines(content: aiohttp.StreamReader) -> AsyncIterator[bytes]:
    """Yield lines of any length: `readline` fails for those of more than 128 kB, and objects may be larger."""
    rest = bytearray()
    async for chunk in content.iter_any():
        rest += chunk
        *lines, rest = rest.split(b"\n") if b"\n" in chunk else [rest]
        for line in lines:
            yield bytes(line)


def _message(text: str) -> str:
    """Return the message of a `Status` object, or else the text itself."""
    try:
        return str(json.loads(text)["message"])
    except (ValueError, KeyError, TypeError):
        return text.strip()[:500] or "no reason given"
