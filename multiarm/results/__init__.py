"""Results: trajectories in memory and in files, and the events of a run."""
