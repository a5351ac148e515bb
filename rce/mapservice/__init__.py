"""Map building as a web service: recordings in, maps out.

A process of its own, beside the Master: recordings are streamed to disk, and each job drives one through a mapping node
in an environment of its user, as a robot would. Needs the extras `server` and `mapping`.
"""
