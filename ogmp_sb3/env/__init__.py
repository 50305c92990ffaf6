"""Batched MuJoCo environments: physics, terms, and the rules of one control step."""
