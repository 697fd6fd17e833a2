"""Checks an installed wheel: reads the patterns of a run, solves a small light field, and simulates.

usage: wheel.py RUN
"""

import platform
import sys

import lumistack
import numpy

print(f"lumistack {lumistack.__version__}, Python {platform.python_version()} on {platform.system()} {platform.machine()}")
print(f"NumPy {numpy.__version__}, zone samples {lumistack.defaults()['render']['zone_samples']}")
stack = lumistack.LayerStack.open(sys.argv[1])
picture = numpy.asarray(stack.simulate((0.05, 0.0)))
assert picture.shape[2] == 3 and picture.std() > 0.01, picture
print(stack, picture.shape)

# smooth views, which patterns can show
display = lumistack.Display("paper-three-layer", resolution=(16, 10), views=(3, 3), frames=2)
views = numpy.zeros(display.light_field_shape, dtype=numpy.float32)
views += (0.5 + 0.3 * numpy.sin(numpy.arange(16) / 3))[:, None]
light_field = lumistack.LightField(views, display=display)
solved = light_field.factorize(iterations=5)
print(solved)
assert solved.psnr(light_field) > 20, solved
