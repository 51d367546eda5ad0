"""Load drivers: servers and clients that benchmarks run as processes of their own."""
