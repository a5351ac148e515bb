"""The Container task set: starts and stops environments on one machine through an engine."""
