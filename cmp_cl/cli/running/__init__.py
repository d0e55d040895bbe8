"""What `cmp-cl run` is made of: its sources, its pipeline, what it derives and what it shows."""
