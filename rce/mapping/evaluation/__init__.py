"""Evaluation of mappers: a simulated robot, and trials on recordings with ground truth.

Benchmarks that need a platform belong to `rce.bench`.
"""
