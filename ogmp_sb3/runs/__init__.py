"""Trainings on disk: begin, log, checkpoint, go on, load."""
