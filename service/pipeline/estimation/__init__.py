"""Estimation (L2-L4): both methods, row inhibitions, disagreement of the methods."""
