"""What a motion says: observables, trajectories and datasets, precision."""
