"""The kernel that flies the orbital-frame model, compiled where a compiler finds its place."""

from service.core.dynamics.orbital_frame_kernel import Fly, compiled_fly


def flight_kernel() -> Fly:
    """Return the compiled kernel; where machine code cannot be kept, every process compiles its own."""
    try:
        return compiled_fly()
    except RuntimeError:
        # a container whose file system is read only: numba finds no place for its cache
        return compiled_fly(is_cached=False)
