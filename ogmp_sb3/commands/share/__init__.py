"""``ogmp-share``: a trained policy with its card, on the Hugging Face Hub or in a directory."""
