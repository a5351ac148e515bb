"""Protocol between robots and the platform: messages, naming rules, binary blobs, and limits that both sides know.

Only pure code belongs here: no sockets and no event loop.
"""
