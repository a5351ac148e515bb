"""Simulated robot with a laser in a floor plan, and the accuracy of maps of it."""

from rce.mapping.evaluation.simulation.drive import Simulation, simulate
from rce.mapping.evaluation.simulation.evaluation import Accuracy, evaluate

__all__ = ["Accuracy", "Simulation", "evaluate", "simulate"]
