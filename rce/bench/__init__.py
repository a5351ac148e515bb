"""Benchmarks of a platform: round trips as in section V of the Rapyuta paper, and small messages beside large ones."""
