"""Pictures of flights: a camera that needs no display, videos, plots."""
