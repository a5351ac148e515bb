"""Benchmarks of a platform and of mappers, behind `rce bench`.

- `routes`, `pairs`, `nodes`, `floors`, `echo`, `payloads`, `run`: round trips as in section V of the Rapyuta paper.
- `soak`, `resources`: robots that come and go for hours; growth of memory and other resources.
- `overtake`: small messages beside large ones. `start`: time until an environment is ready.
- `crowd`, `hollow`, `dashboard`: a Master with many robots, its lists and its dashboard.
- `maps`, `large_recording`: mappers and the map service.
- `report`, `statistics`, `plot`, `maps_report`, `maps_plot`: results as text, JSON and pictures.

The command line itself is in `rce.cli`.
"""
