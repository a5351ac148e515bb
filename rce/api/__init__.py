"""Shared definitions of the platform's HTTP API, used by the servers and their clients.

Types of requests and responses (`views`, `map_jobs`), roles and key scopes, join codes, the OpenAPI generator, and
blocking HTTP clients that need only the standard library and msgspec. Nothing here depends on a server.
"""
