"""Tests of the measuring commands and of the pages they write."""
