"""Map service: recordings in, maps out, over HTTP.

The service is a process of its own beside the Master. Uploaded recordings are streamed to disk. Each job plays one of
them through a mapping node in an environment of its user, as a client of the platform. Mapping itself belongs to
`rce.mapping`. Needs the extras `server` and `mapping`.
"""
