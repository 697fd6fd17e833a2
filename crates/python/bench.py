"""Measures the package's overhead: import time, and calls on a light field of 5×5 views of 100×160
pixels (4.8 MB).

    python crates/python/bench.py
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

import lumistack

#: Seconds that an import may take.
IMPORT_LIMIT = 0.3
IMPORT = "import time; t = time.perf_counter(); import lumistack; print(time.perf_counter() - t)"


def best(work: Callable[[], object], times: int = 30) -> float:
    """Returns the time of the fastest of several runs, milliseconds."""
    taken = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return 1e3 * min(taken)


def main() -> int:
    runs = [float(subprocess.check_output([sys.executable, "-c", IMPORT])) for _ in range(7)]
    print(f"import: {1e3 * min(runs):.1f} ms at best, {1e3 * statistics.median(runs):.1f} ms at the median")

    display = lumistack.Display("paper-three-layer", resolution=(160, 100))
    radiance = np.random.default_rng(1).random(display.light_field_shape, np.float32)
    light_field = lumistack.LightField(radiance, display=display)
    stack = lumistack.factorize(light_field, iterations=0)
    size = "×".join(str(n) for n in radiance.shape)
    print(f"light field of {size}, {radiance.nbytes / 1e6:.1f} MB")
    double, fortran = radiance.astype("f8"), np.asfortranarray(radiance)
    codes = (radiance * 255).astype("u1")
    for name, work in (
        ("numpy: a copy of the array", lambda: radiance.copy()),
        ("LightField(float32)", lambda: lumistack.LightField(radiance, display=display)),
        ("LightField(float64)", lambda: lumistack.LightField(double, display=display)),
        ("LightField(float32, Fortran order)", lambda: lumistack.LightField(fortran, display=display)),
        ("LightField(uint8)", lambda: lumistack.LightField(codes, display=display)),
        ("light_field.radiance", lambda: light_field.radiance),
        ("stack.layers", lambda: stack.layers),
        ("factorize(iterations=0, coarse_levels=0)", lambda: lumistack.factorize(light_field, iterations=0, coarse_levels=0)),
        ("factorize(iterations=1, coarse_levels=0)", lambda: lumistack.factorize(light_field, iterations=1, coarse_levels=0)),
        ("stack.psnr(light_field)", lambda: stack.psnr(light_field)),
        ("simulate(stack)", lambda: lumistack.simulate(stack)),
    ):
        print(f"{name:42} {best(work):9.4f} ms")
    tiny = lumistack.Display("fig7-uniform", resolution=(1, 1), views=(1, 1), frames=1)
    nothing = lumistack.LightField(np.zeros(tiny.light_field_shape, "f4"), display=tiny)
    call = best(lambda: lumistack.factorize(nothing, tiny, iterations=0, coarse_levels=0), 300)
    print(f"{'factorize of one pixel: the call itself':42} {call:9.4f} ms")
    return int(min(runs) > IMPORT_LIMIT)


if __name__ == "__main__":
    sys.exit(main())
