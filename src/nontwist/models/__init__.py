"""Bodies as data: Euler inertia, constrained axis, dead director forces."""
