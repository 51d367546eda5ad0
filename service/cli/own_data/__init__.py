"""Commands and dialogues that bring an operator's own data to the service.

Public: angles, archive_progress, ephemeris, foreign_archive, foreign_file, spacecraft, tdm_archive.
"""
