"""Pictures, videos and the browser viewer of one environment."""
