"""Shared parts of the platform's HTTP servers, which are aiohttp: those of the Master, the map service and bridges.

Listening and stopping, reading requests, errors as problem+json, health, OpenAPI documents. Routes and handlers belong
to each server's own package; clients belong to `rce.api` and `rce.client`.
"""
