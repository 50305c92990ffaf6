"""The only modules that import matplotlib."""
