"""Errors of trajectories against ground truth, and a simulated room with a camera that moves through it."""
