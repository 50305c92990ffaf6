"""Pages and pictures about runs and sweeps."""
