"""Mapper `particle`: a Rao-Blackwellized particle filter behind laser odometry.

- `mapper`: the mapper, which decides when the filter takes a step.
- `filter`, `kernels`: the filter and its compiled inner loops.
- `tiles`, `paths`: maps and paths of the particles, which share what they have in common.
- `path_graph`: pose graph along the best path, for loops that no particle closes.
"""
