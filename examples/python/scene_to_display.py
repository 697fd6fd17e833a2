"""Renders a scene, factorizes its light field and simulates the display, all in memory.

    python examples/python/scene_to_display.py scenes/still-life/still-life.gltf out
"""

from __future__ import annotations

import argparse
from pathlib import Path

import lumistack


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("scene", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--samples", type=int, default=8)
    arguments = parser.parse_args()

    display = lumistack.Display("paper-three-layer", resolution=(210, 131), frames=6)
    print(display)

    scene = lumistack.Scene(arguments.scene)
    print(scene)

    def progress(stage: str, fraction: float) -> None:
        print(f"\r{stage} {fraction:4.0%}", end="", flush=True)

    light_field = lumistack.render(scene, display, samples=arguments.samples, callback=progress)
    print(f"\r{light_field}")
    print(f"depth: {light_field.info['depth_sentence']}")

    stack = lumistack.factorize(light_field, iterations=20, callback=progress)
    print(f"\r{stack}")

    # Simulate the picture for an eye 60 mm to the right of the middle and half a metre in front of
    # the display. The picture is linear light, [row, col, rgb].
    seen = lumistack.simulate(stack, eye_mm=(60.0, 0.0, 500.0))
    print(f"from the right: mean {seen.mean():.3f}")

    stack.save(arguments.folder)
    for file in lumistack.write(stack, "web_simulator", arguments.folder / "preview", target=light_field):
        if file.suffix == ".html":
            print(arguments.folder / "preview" / file)
    report = lumistack.report(stack, light_field, arguments.folder, title=arguments.scene.stem)
    print(f"{report['psnr_view']:.1f} dB: {arguments.folder / 'report.html'}")


if __name__ == "__main__":
    main()
