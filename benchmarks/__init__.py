"""Measurements that are not part of the package: the paper's tables, and speed."""
