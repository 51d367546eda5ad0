"""Reproduction of the study of relay-pulse wheel control of a flexible spacecraft."""
