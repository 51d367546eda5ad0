"""Estimation (L2-L4): both methods, row inhibitions, disagreement of the methods.

Public: carrier_results, method, method_disagreement, row_evidence, row_inhibitions.
"""
