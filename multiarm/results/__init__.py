"""What a run leaves: trajectories, channels, files."""
