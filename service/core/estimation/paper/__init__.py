"""The published method: harmonics, sensitivities by sign, octants, the fade rule."""
