"""Control connections between the processes of the platform: typed two-way calls over Perspective Broker.

The calls themselves are in `rce.control.calls`; their handlers belong to the processes that answer them.
"""
