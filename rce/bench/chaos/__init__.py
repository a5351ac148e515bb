"""Processes of a platform fail at random under load, and what it acknowledged is compared with what is there.

- `model`, `history`: what was acknowledged, and a record of commands and faults.
- `platform`, `disks`, `processes`: the platform, its directories of limited size, and its processes.
- `workload`, `flows`: commands and numbered messages of robots.
- `faults`: what fails, and when it works again.
- `audit`: comparison of the model with REST, processes and directories.
- `run`, `report`: a run and its result.
"""
