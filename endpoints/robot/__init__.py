"""Robot endpoint: robots' WebSockets on one side, data links on the other, and the conversion between them.

Message formats belong to `converters`, the frames of the WebSocket to `rce.protocol`.
"""
