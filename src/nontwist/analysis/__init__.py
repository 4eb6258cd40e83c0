"""From states to named variables: trajectories and datasets, invariants, statistics, measured orders."""

from .variables import OBSERVABLES, Observable

__all__ = ["OBSERVABLES", "Observable"]
