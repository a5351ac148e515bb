"""State of the running platform as others see it: views, feed, events, traces and metrics."""
