"""``soo serve`` whose filter kernels have worked already, as in a service that has been up for a while.

Run ``python -m bench.load.warm_server serve ...`` with the options of ``soo serve``; the kernels are those of the
setting ``SOO_KERNELS``.
"""

from bench.bench_chain import measure_filter
from service.__main__ import main
from service.composition.settings import Settings
from service.pipeline.kernels import kernels_named

if __name__ == "__main__":
    measure_filter(16, 5, kernels_named(Settings.model_validate({}).kernels))
    main()
