"""Long work: calibrations, alignments, replays, archive maintenance."""
