"""Observables, trajectories and datasets, twist, measured orders."""

from .variables import OBSERVABLES, Observable

__all__ = ["OBSERVABLES", "Observable"]
