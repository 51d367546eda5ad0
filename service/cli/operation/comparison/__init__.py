"""Command `soo compare`: two versions of the attitude side by side."""
