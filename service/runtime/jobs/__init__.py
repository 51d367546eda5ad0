"""Long work: calibrations, alignments, replays, analyses, archive maintenance."""
