"""Two Masters with one PostgreSQL, of which the leader fails again and again under load.

- `programs`, `database`, `clock`: processes that start again, a private PostgreSQL, and clocks that jump.
- `platform`: the platform, whose Masters and database are machines of a network of their own.
- `terms`: who led when, and who acknowledged writes meanwhile.
- `faults`: what fails.
- `run`, `report`: a run and its result.

Robots, their model and the comparison are those of `rce.bench.chaos`.
"""
