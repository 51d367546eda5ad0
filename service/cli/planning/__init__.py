"""Commands `soo plan`, selection of carriers and timetable of turns, and `soo beams`, where the antennas point."""
