"""A robot with a laser that drives through a floor plan, and how good a map of it is."""

from rce.mapping.simulation.drive import Simulation, simulate
from rce.mapping.simulation.evaluation import Accuracy, evaluate

__all__ = ["Accuracy", "Simulation", "evaluate", "simulate"]
