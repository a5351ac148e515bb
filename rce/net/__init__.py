"""Networking below the protocols: TLS, certificates, sockets, bounded queues, and the handshake of data relays.

Modules here import nothing of RCE but its errors, so that every process and client can use them.
"""
