"""The cascade: stages and factorizations as data, and the grasp sampler."""
