"""Carrying plans out: calls to processes, what becomes ready by them, and what ends by itself."""
