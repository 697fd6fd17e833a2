"""Code that the Blender extension and the export of .blend files share. `rig`, `handover`,
`unshown` and `usd` use `bpy`; the other modules are plain Python.

Lengths in the display are millimetres, in the scene Blender's units. Display space has x to the
right, y up, z to the viewer, and z = 0 is the display plane.
"""
