"""How fast trials, sampling and training are, each against a yardstick measured beside it."""
