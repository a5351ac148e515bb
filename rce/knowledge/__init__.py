"""Knowledge service: action recipes, objects and environments that robots share, after RoboEarth's repository.

The service is a process of its own beside the Master. Entries, their versions and their index are in a SQLite database,
files in a directory. OWL texts are read and queries are answered in child processes that can be killed. Types of the
HTTP API belong to `rce.api.knowledge`, the client to `rce.client`. Needs the extras `server` and `knowledge`.
"""
