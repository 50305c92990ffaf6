"""``ogmp-train``: one training, a sweep, a search, or one that goes on."""
