"""Spectrum analyzer drivers, one dialect a file.

Public: base, choice, scpi_driver, siglent, visa_session.
"""
