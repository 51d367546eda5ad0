"""Commands and dialogues that bring an operator's own data to the service.

Public: angles, archive_progress, foreign_file, tdm_archive.
"""
