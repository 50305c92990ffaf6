"""``ogmp-bench``: how fast simulation, learner and training are."""
