"""Studies: make seeds, train, collect, evaluate."""
