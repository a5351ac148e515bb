"""Shared parts of the platform's HTTP servers, which are aiohttp: the Master's and the map service's.

Listening and stopping, reading requests, errors as problem+json, health, OpenAPI documents. Routes and handlers belong
to each server's own package; clients belong to `rce.api` and `rce.client`.
"""
