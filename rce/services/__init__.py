"""Parts of all services beside the Master: authentication of their clients at the Master, audit, errors, health.

A service is a process that has joined the platform and is a HTTP server of its own, such as the map service. What it
offers belongs to its own package; what all HTTP servers share belongs to `rce.web`. Needs the extra `server`.
"""
