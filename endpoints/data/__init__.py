"""Data path of an endpoint: interfaces, the routes between them, and the links that carry their messages.

Everything here is the same for robots, environments and bridges. What an interface converts or publishes belongs to
the package of its endpoint; the queue in front of a stream is `rce.net.outbox`.
"""
