"""Observables, trajectories and datasets, twist, measured orders."""
