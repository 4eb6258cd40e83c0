"""From a system, a start, a load and times to a run, or to many."""
