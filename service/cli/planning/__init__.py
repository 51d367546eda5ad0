"""Command `soo plan`: selection of carriers and timetable of turns."""
