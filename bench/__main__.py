"""All benchmarks, one after another: ``python -m bench``. Exit code 1 when a goal is missed."""

import sys

from bench import (
    bench_chain,
    bench_ingest,
    bench_replay,
    bench_start,
    bench_storage,
    bench_stream,
    bench_summaries,
)
from bench.load import bench_memory, fleet


def main() -> int:
    """Run them and return the exit code."""
    measured = (
        bench_storage,
        bench_ingest,
        bench_chain,
        bench_replay,
        bench_stream,
        bench_start,
        bench_summaries,
        bench_memory,
        fleet,
    )
    is_met = [each.main() for each in measured]
    return 0 if all(is_met) else 1


if __name__ == "__main__":
    sys.exit(main())
