"""The method: modes say what should happen, oracles plan how. Nothing is simulated."""
