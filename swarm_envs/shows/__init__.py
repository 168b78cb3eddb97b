"""Shows: formations with lights, planned, flown, filmed and exported. See docs/show.md."""
